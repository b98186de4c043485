"""Lines and records of boards, in four settings.

Nothing raises; a row has a finite number or NaN for each column; what is held back and what is
left out is bounded by what came; rows do not depend on how the bytes were cut; what is emitted
has the declared shape.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Sequence
from functools import cache

from biosensor_gateway.devices.line_sensor.driver import row_protocol
from biosensor_gateway.devices.line_sensor.driver.emitter import LineEmitter
from biosensor_gateway.devices.line_sensor.driver.protocol import MAX_LINE_BYTES, BadLine, Row
from biosensor_gateway.devices.line_sensor.driver.settings import LineSettings
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds
from tests.fuzz.streams import same_in_any_split

_COLUMNS = ("n", "t [us]", "acc/x [g]", "acc/y [g]", "acc/z [g]", "gsr/gsr [microsiemens]")
_FORMATS = (
    {"format": "csv", "udp_port": 5005},
    {"format": "csv", "separator": "semicolon", "port": "COM1"},
    {"format": "json", "url": "ws://localhost:81/"},
    {
        "format": "struct",
        "port": "COM1",
        "struct_format": "<IIffff",
        "frame_start": "aa55",
        "checksum": "crc16",
    },
)


@cache
def _settings(number: int) -> LineSettings:
    return LineSettings.model_validate(
        {
            "sensor": "line_sensor",
            "unit": "1",
            "columns": _COLUMNS,
            "sequence_column": "n",
            "time_column": "t",
            "rate_hz": 100.0,
            **_FORMATS[number],
        }
    )


def check(data: bytes) -> None:
    """Read the bytes behind the first, which chooses the settings, and emit the rows."""
    settings = _settings(data[0] % len(_FORMATS) if data else 0)
    rows, _ = same_in_any_split(data[1:], lambda pieces: _read(settings, pieces))
    for row in rows:
        ensure(len(row) == len(_COLUMNS), "another number of columns", row)
        ensure(not any(map(math.isinf, row)), "it is no number", row)
    emitter = LineEmitter(settings, CheckedSink("line_sensor"))
    for number, row in enumerate(rows):
        emitter.take([row], ARRIVAL_S + number / 100)


def _read(settings: LineSettings, pieces: Sequence[bytes]) -> tuple[list[Row], int]:
    protocol = row_protocol(settings)
    found: list[Row | BadLine] = []
    for piece in pieces:
        found += protocol.feed(piece)
        ensure(protocol.buffered <= MAX_LINE_BYTES, "too much is held back", protocol.buffered)
    bad = sum(each.size for each in found if isinstance(each, BadLine))
    ensure(bad <= sum(map(len, pieces)), "more is left out than came", bad)
    left_out = bad + protocol.buffered if settings.format == "struct" else bad
    return [each for each in found if not isinstance(each, BadLine)], left_out


def seeds() -> Seeds:
    """The first byte is what `line_sensor` makes of it: which settings the lines are for."""
    csv = [b"1,1000,0.1,-2,3e1,4.5", b"2,2000,,nan,ovf,4.5", b"n,t,x,y,z,gsr", b"3;3000;1;2;3;4"]
    said = [b'{"n":1,"t":9,"acc":{"x":1,"y":2,"z":3},"gsr":4}', b'{"n":2,"t":10}', b"[1,2,3,4,5,6]"]
    values = struct.pack("<IIffff", 1, 1000, 1.0, 2.0, 3.0, 4.0)
    record = b"\xaa\x55" + values + struct.pack("<H", binascii.crc_hqx(values, 0xFFFF))
    yield "csv", b"\0" + b"\r\n".join([*csv, b"# comment", b""])
    yield "csv_turns", b"\0" + b"4294967295,4294967290,1,1,1,1\n0,4,1,1,1,1\n"
    yield "csv_long", b"\0" + b"9" * 5000 + b"\n" + csv[0] + b"\n"
    yield "semicolons", b"\1" + csv[3] + b"\n4;1,5;1,5;2;3;4\n"
    yield "json", b"\2" + b"\n".join([*said, b""])
    yield "json_nested", b"\2" + b"[" * 4000 + b"\n"
    yield "json_number", b"\2" + b"[" + b"9" * 4000 + b",1,1,1,1,1]\n"
    yield "struct", b"\3" + record + b"\xaa" + record
    yield "struct_cut", b"\3" + record[:9] + record


def _any_column_number(_reader: object, word: str) -> float:
    return float(word)


FAULT: Fault = (
    "biosensor_gateway.devices.line_sensor.driver.protocol.CsvReader",
    "_number",
    instead(_any_column_number),
)
"""How the reader is broken to see that the corpus finds it."""
