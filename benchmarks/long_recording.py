"""Makes a recording as a lab has it after hours: an EEG of 32 channels and seven sensors.

Chunks come every half second, clock offsets every 5 s, boundaries every 10 s, as LabRecorder
writes them; an agent tells the time of day every 5 s.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl_header import describe
from biosensor_common.naming import AGENT, lsl_name, source_id
from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice, StreamSpec
from biosensor_gateway.recording.xdf.container import BOUNDARY, MAGIC, Tag, framed
from tests.rigs.headers import declared_streams
from tests.rigs.turns import OF_A_LAB

BEGIN_S = 50_000.0
_UNIX_NS = 1_790_000_000_000_000_000
_STEP_S, _OFFSET_S, _BOUNDARY_S = 0.5, 5.0, 10.0
_EEG_HZ, _EEG_CHANNELS = 500.0, 32
# What has no rate comes as often as hearts beat.
_IRREGULAR_HZ = 1.0
_MADE_S = 60.0
_DTYPES = {ChannelFormat.FLOAT32: "<f4", ChannelFormat.INT16: "<i2", ChannelFormat.INT32: "<i4"}
_FILE_HEADER = b"<?xml version='1.0'?><info><version>1.0</version></info>"


@dataclass(frozen=True, slots=True)
class Made:
    """One stream: its header, how often it has a sample, and of what type; None for text."""

    header: bytes
    rate: float
    channels: int
    dtype: str | None


def of_a_lab() -> list[Made]:
    """Return the streams of seven sensors and of the agent, and an EEG."""
    return [*_sensors(), _eeg()]


def of_signals(rates: Sequence[float]) -> list[Made]:
    """Return streams of other programs, with two channels each, at these rates in Hz."""
    return [
        Made(_xml(_signal(number, rate), ET.Element("desc")), rate, 2, "<f4")
        for number, rate in enumerate(rates, 1)
    ]


def write(path: Path, seconds: float, streams: Sequence[Made]) -> None:
    """Write a recording of so many seconds."""
    random = np.random.default_rng(14)
    with path.open("xb") as file:
        file.write(MAGIC + framed(Tag.FILE_HEADER, _FILE_HEADER))
        for number, stream in enumerate(streams, 1):
            file.write(framed(Tag.STREAM_HEADER, struct.pack("<I", number) + stream.header))
        begin_s = 0.0
        while begin_s < seconds:
            length_s = min(_MADE_S, seconds - begin_s)
            _write_part(file, streams, begin_s, length_s, random)
            begin_s += length_s
        for number, stream in enumerate(streams, 1):
            count = math.ceil(seconds * stream.rate)
            content = f"<info><sample_count>{count}</sample_count></info>".encode()
            file.write(framed(Tag.STREAM_FOOTER, struct.pack("<I", number) + content))


def _write_part(
    file: BinaryIO,
    streams: Sequence[Made],
    begin_s: float,
    length_s: float,
    random: np.random.Generator,
) -> None:
    made = [list(_chunks(each, begin_s, length_s, random)) for each in streams]
    for step in range(round(length_s / _STEP_S)):
        now_s = begin_s + step * _STEP_S
        for number, chunks in enumerate(made, 1):
            if chunks[step]:
                file.write(framed(Tag.SAMPLES, struct.pack("<I", number) + chunks[step]))
            if now_s % _OFFSET_S == 0:
                offset = struct.pack("<Idd", number, BEGIN_S + now_s, 1e-5 * random.normal())
                file.write(framed(Tag.CLOCK_OFFSET, offset))
        if now_s % _BOUNDARY_S == 0:
            file.write(framed(Tag.BOUNDARY, BOUNDARY))


def _chunks(
    stream: Made, begin_s: float, length_s: float, random: np.random.Generator
) -> Iterator[bytes]:
    """Give the content of each half second's chunk; empty where no sample falls into it."""
    first, last = (math.ceil(each * stream.rate) for each in (begin_s, begin_s + length_s))
    stamps = BEGIN_S + np.arange(first, last) / stream.rate
    ends = BEGIN_S + begin_s + _STEP_S * np.arange(round(length_s / _STEP_S) + 1)
    places = np.searchsorted(stamps, ends)
    places[-1] = len(stamps)
    records = None if stream.dtype is None else _records(stream, stamps, random)
    for begin, end in pairwise(places):
        if begin == end:
            yield b""
            continue
        body = _texts(stamps[begin:end]) if records is None else records[begin:end].tobytes()
        yield b"\x04" + struct.pack("<I", end - begin) + body


def _records(
    stream: Made, stamps: NDArray[np.float64], random: np.random.Generator
) -> NDArray[Any]:
    assert stream.dtype is not None
    layout = [("size", "u1"), ("stamp", "<f8"), ("values", stream.dtype, (stream.channels,))]
    records = np.zeros(len(stamps), layout)
    records["size"], records["stamp"] = 8, stamps
    records["values"] = 30.0 * random.standard_normal((len(stamps), stream.channels))
    return records


def _texts(stamps: NDArray[np.float64]) -> bytes:
    parts: list[bytes] = []
    for stamp in stamps.tolist():
        clock = {"lsl_s": stamp, "unix_ns": _UNIX_NS + round(stamp * 1e9)}
        text = json.dumps({"event": "heartbeat", "clock": clock}).encode()
        parts.append(b"\x08" + struct.pack("<d", stamp) + b"\x04" + struct.pack("<I", len(text)))
        parts.append(text)
    return b"".join(parts)


def _sensors() -> Iterator[Made]:
    for sensor, stream in declared_streams():
        if sensor not in {*OF_A_LAB, AGENT}:
            continue
        assert not isinstance(stream.rate, FromDevice)
        # The generic heart rate sensor is no eighth one, but stands in for the other brands.
        owner = DeviceIdentity(sensor, "A1B2C3D4", "" if sensor == AGENT else "P01")
        header = _header(stream, owner, stream.rate)
        rate = stream.rate or _IRREGULAR_HZ
        if stream.format is ChannelFormat.STRING:
            rate = stream.rate or 1 / _OFFSET_S
        yield Made(header, rate, len(stream.channels), _DTYPES.get(stream.format))


def _header(stream: StreamSpec, owner: DeviceIdentity, rate: float) -> bytes:
    desc = describe(stream, owner, DeviceInfo(manufacturer="Maker", model="Model"))
    facts = {
        "name": lsl_name(owner, stream.data_name),
        "type": stream.content_type.value,
        "channel_count": str(len(stream.channels)),
        "nominal_srate": repr(rate),
        "channel_format": stream.format.value,
        "source_id": source_id(owner, stream.data_name),
    }
    return _xml(facts, desc)


def _eeg() -> Made:
    desc = ET.Element("desc")
    channels = ET.SubElement(desc, "channels")
    for place in range(_EEG_CHANNELS):
        channel = ET.SubElement(channels, "channel")
        ET.SubElement(channel, "label").text = f"E{place + 1}"
        ET.SubElement(channel, "unit").text = "microvolts"
        ET.SubElement(channel, "type").text = "EEG"
    facts = _facts("EEG", _EEG_HZ, _EEG_CHANNELS, "amplifier-1")
    return Made(_xml(facts, desc), _EEG_HZ, _EEG_CHANNELS, "<f4")


def _signal(number: int, rate: float) -> dict[str, str]:
    return _facts(f"signal {number}", rate, 2, f"signal-{number}")


def _facts(name: str, rate: float, channels: int, source: str) -> dict[str, str]:
    return {
        "name": name,
        "type": "EEG",
        "channel_count": str(channels),
        "nominal_srate": repr(rate),
        "channel_format": "float32",
        "source_id": source,
    }


def _xml(facts: dict[str, str], desc: ET.Element) -> bytes:
    info = ET.Element("info")
    for tag, text in {**facts, "created_at": repr(BEGIN_S), "hostname": "lab"}.items():
        ET.SubElement(info, tag).text = text
    info.append(desc)
    return ET.tostring(info)
