"""Makes the seeds of the corpora from the vectors and recordings of the repository.

``python -m tests.fuzz.grow`` takes over those that reach what the corpora do not.
"""

from __future__ import annotations

import binascii
import json
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, cast

from tests.fuzz import text_seeds
from tests.fuzz.streams import join_counted

_TESTS = Path(__file__).parents[1]
_RECORDINGS = _TESTS.parent / "gateway_win/biosensor_gateway/devices/zephyr/simulator/recordings"
_PMD_DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
_CAPTURE_BYTES = 600
# Vectors that test size alone are tested elsewhere.
_MAX_BYTES = 8192

Seeds = Iterator[tuple[str, bytes]]


def vectors(path: str) -> list[dict[str, Any]]:
    """Return the vectors of a file below `tests`."""
    content = json.loads((_TESTS / path).read_text(encoding="utf-8"))
    return cast(
        "list[dict[str, Any]]", content if isinstance(content, list) else content["vectors"]
    )


def _hex(found: Iterable[dict[str, Any]]) -> Seeds:
    for vector in found:
        if vector.get("hex"):
            yield vector["name"], bytes.fromhex(vector["hex"])


def _zephyr() -> Seeds:
    named = list(_hex(vectors("zephyr/vectors/zephyr_bioharness.json")))
    yield from named
    for recording in sorted(_RECORDINGS.glob("*.dat")):
        content = recording.read_bytes()
        yield f"{recording.stem}_begin", content[:_CAPTURE_BYTES]
        middle = len(content) // 2
        yield f"{recording.stem}_middle", content[middle : middle + _CAPTURE_BYTES]


def _shimmer3() -> Seeds:
    """Each vector in the three checksum modes; the first byte is what `shimmer3` makes of it."""
    found = [
        vector
        for vector in vectors("shimmer3_gsr/vectors/shimmer3.json")
        if vector["kind"] in ("response", "data", "stream", "command")
    ]
    for name, data in _hex(found):
        for setup in (0, 1, 2, 9, 11, 20, 27, 29):
            yield f"{name}_{setup}", bytes((setup,)) + data
    for mode in range(3):
        yield f"packets_{mode}", bytes((mode + 36,)) + _shimmer_packets()
    yield from _shimmer_family()


def _shimmer_family() -> Iterator[tuple[str, bytes]]:
    """What a device's memory tells, and packets of all its sensors."""
    for vector in vectors("shimmer/vectors/shimmer.json"):
        data, name = bytes.fromhex(vector["hex"]), vector["name"]
        if vector["kind"] == "block":
            yield f"memory_{name}", bytes((33,)) + b"\xff\x2d" + 6 * data
        elif vector["kind"] == "registers":
            yield f"registers_{name}", bytes((27,)) + b"\xff\x62\x0a" + data
        elif vector["kind"] == "air":
            said = bytes((0xFF, 0xA6, 1 + len(data), vector["chip"]))
            yield f"air_{name}", bytes((27,)) + said + data
    for streams, size in enumerate((43, 24, 38)):
        packets = (
            b"\0" + (256 * at).to_bytes(3, "little") + bytes(range(at, at + size))
            for at in range(12)
        )
        yield f"all_sensors_{streams}", bytes((108 + 9 * streams,)) + b"".join(packets)


def _shimmer_packets() -> bytes:
    ticks = range(0xFFF000, 0xFFF000 + 40 * 512, 512)
    return b"".join(
        b"\0" + (tick & 0xFFFFFF).to_bytes(3, "little") + struct.pack("<HH", 2000 + at, 0x4800 + at)
        for at, tick in enumerate(ticks)
    )


def _vernier() -> Seeds:
    named = list(_hex(vectors("vernier_respiration_belt/vectors/vernier_gdxrb.json")))
    said = [(name, data) for name, data in named if data[0] != 0x58]
    yield from said
    yield "all", b"".join(data for _, data in said)


def _polar() -> tuple[list[tuple[str, bytes]], list[tuple[str, bytes]]]:
    frames: list[tuple[str, bytes]] = []
    control: list[tuple[str, bytes]] = []
    for name in ("polar_pmd_h10", "polar_pmd_verity"):
        for vector in vectors(f"polar_h10/vectors/{name}.json"):
            if vector["hex"]:
                into = frames if vector["characteristic"] == _PMD_DATA else control
                into.append((vector["name"], bytes.fromhex(vector["hex"])))
    return frames, control


def _heart_rate() -> Seeds:
    yield from _counted(_hex(vectors("ble_heart_rate/vectors/ble_heart_rate.json")))
    yield "batteries", join_counted([b"\x00", b"\x64", b"\x65", b"\xff"])
    yield "texts", join_counted([b"Polar H10\0", b" 3.1.1\n", b"\xff\xc3\xa4"])


def _counted(named: Iterable[tuple[str, bytes]]) -> Seeds:
    found = list(named)
    for name, data in found:
        yield name, join_counted([data])
        yield f"{name}_twice", join_counted([data, data])
    yield "all", join_counted([data for _, data in found])


def _e4() -> Seeds:
    for vector in vectors("empatica_e4/vectors/empatica_e4.json"):
        parts = vector.get("chunks") or [vector["message"]]
        if isinstance(parts, str):
            continue
        data = b"".join(
            bytes.fromhex(part[4:]) if part.startswith("hex:") else part.encode() for part in parts
        )
        if len(data) < _MAX_BYTES:
            yield vector["name"], data
    yield "odd_digits", "R device_list \u00b2 | a\nE4_Bvp \u0661 2\nE4_Bvp 1\u00b2 2\n".encode()
    yield "odd_length_of_number", b"E4_Bvp 1 " + b"9" * 5000 + b"\n"


def _cortex() -> Seeds:
    lines: list[str] = []
    for vector in vectors("emotiv_insight/vectors/emotiv_cortex.json"):
        line = vector["raw"] if "raw" in vector else json.dumps(vector["message"])
        data: str = line
        if "cols" in vector:
            message = cast("dict[str, Any]", vector.get("message", {}))
            success = {
                "streamName": next((key for key in message if key != "sid"), "eeg"),
                "cols": vector["cols"],
                "sid": message.get("sid", ""),
            }
            reply = {"id": 7, "result": {"success": [success], "failure": []}}
            data = f"{json.dumps(reply)}\n{line}"
        lines.append(data)
        yield vector["name"], data.encode("utf-8", "replace")
    yield "odd_huge_number", b'{"id":1,"result":{"failure":[{"code":1' + b"0" * 400 + b"}]}}"
    yield "odd_nested", b'{"sid":' + b"[" * 3000
    yield "all", "\n".join(lines).encode("utf-8", "replace")[:_MAX_BYTES]


def _line_sensor() -> Seeds:
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


def seeds() -> dict[str, Seeds]:
    """Return the seeds of each target, with their names."""
    frames, control = _polar()
    return {
        "ble_heart_rate": _heart_rate(),
        "bluetooth_health": _counted(
            _hex(vectors("bluetooth_health/vectors/bluetooth_health.json"))
        ),
        "emotiv_cortex": _cortex(),
        "empatica_e4": _e4(),
        "line_sensor": _line_sensor(),
        "movesense": _counted(_hex(vectors("movesense/vectors/movesense_gsp.json"))),
        "polar_control": _counted(control),
        "polar_frames": _counted(frames),
        "shimmer3": _shimmer3(),
        "vernier": _vernier(),
        "zephyr": _zephyr(),
        **text_seeds.seeds(),
    }


def write_seeds(folder: Path) -> None:
    """Write all seeds, a folder for each target."""
    for target, found in seeds().items():
        place = folder / target
        place.mkdir(parents=True, exist_ok=True)
        for name, data in found:
            (place / name).write_bytes(data)
