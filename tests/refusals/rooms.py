"""The modules through which samples and messages pass: the data rooms."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.refusals.drops import IN_DRIVERS, IN_RECORDER, REPORTS

ROOT = Path(__file__).parents[2]
_COMMON = "common/biosensor_common"
_NODE, _AGENT = "ros_side/lsl_to_ros/lsl_to_ros", "gateway_win/biosensor_gateway"
_PATTERNS = (
    f"{_COMMON}/lsl/inlet.py",
    f"{_COMMON}/lsl/network.py",
    f"{_COMMON}/lsl/sender_clocks.py",
    f"{_COMMON}/ros/layout.py",
    f"{_NODE}/lsl/*.py",
    f"{_NODE}/topics/*.py",
    f"{_NODE}/statistics/*.py",
    f"{_NODE}/routing.py",
    f"{_NODE}/subscriber_thread.py",
    *(f"{_NODE}/ros_to_lsl/{each}.py" for each in (
        "application", "bridge", "graph", "node", "outlets", "reports",
        "senders", "stamps",
    )),
    *(f"{_AGENT}/streaming/{each}.py" for each in (
        "markers", "outlets", "silence", "sink", "stages",
    )),
    f"{_AGENT}/streaming/events/*.py",
    f"{_AGENT}/agent/markers.py",
    f"{_AGENT}/features/*.py",
    f"{_AGENT}/pulses.py",
    f"{_AGENT}/page/network/*.py",
    f"{_AGENT}/captures/*.py",
    *(f"{_AGENT}/recording/recorder/{each}.py" for each in (
        "live_file", "program", "receiver", "recording_file", "streams",
    )),
)  # fmt: skip
_DRIVERS = (f"{_AGENT}/devices/*/driver/emitter.py", f"{_AGENT}/devices/*/driver/*.py")


PATTERNS = (*_PATTERNS, *_DRIVERS)


def data_rooms() -> list[Path]:
    """Return their files, but those without a function, which drop nothing."""
    found = sorted({path for each in PATTERNS for path in ROOT.glob(each)})
    return [path for path in found if "def " in source_of(path)]


def source_of(room: Path) -> str:
    """Return the code through which data pass, in the lines where it stands: of a driver's modules
    the emitters, for what else is in them talks with the device."""
    text = room.read_text()
    if "driver" not in room.parts or room.name == "emitter.py":
        return text
    kept = {
        number
        for each in ast.parse(text).body
        if isinstance(each, ast.ClassDef) and each.name.endswith("Emitter")
        for number in range(each.lineno, (each.end_lineno or 0) + 1)
    }
    lines = enumerate(text.splitlines(), 1)
    return "\n".join(line if number in kept else "" for number, line in lines)


def reports_of(room: Path) -> frozenset[str]:
    """Return the methods by which a room reports: drivers have the verbs of their sink, the
    recorder tells the verdict on its recording."""
    if "recorder" in room.parts:
        return IN_RECORDER
    return IN_DRIVERS if "driver" in room.parts else REPORTS
