"""The modules through which samples and messages pass: the data rooms."""

from __future__ import annotations

from pathlib import Path

from tests.refusals.drops import IN_DRIVERS, REPORTS

ROOT = Path(__file__).parents[2]
_NODE, _AGENT = "ros_side/lsl_to_ros/lsl_to_ros", "gateway_win/biosensor_gateway"
_PATTERNS = (
    "common/biosensor_common/ros/layout.py",
    *(f"{_NODE}/lsl/{each}.py" for each in (
        "delivery", "descriptions", "discovery", "inlets", "pulls", "reading", "duplicates",
    )),
    "common/biosensor_common/lsl/namesakes.py",
    f"{_NODE}/topics/*.py",
    f"{_NODE}/routing.py",
    f"{_NODE}/taking.py",
    *(f"{_NODE}/ros_to_lsl/{each}.py" for each in (
        "application", "bridge", "events", "graph", "losses", "outlets",
        "pairs", "senders", "stamping", "texts", "topic",
    )),
    *(f"{_AGENT}/streaming/{each}.py" for each in (
        "sink", "outlets", "device_outlets", "own_outlets", "pause_gate", "markers",
        "events/announcer", "plausibility", "silence",
    )),
    f"{_AGENT}/agent/markers.py",
    *(f"{_AGENT}/features/{each}.py" for each in (
        "beside", "breathing", "chains", "filters", "heart", "links", "live", "motion", "offline",
        "outputs", "quality", "r_peaks", "runs", "skin", "sources",
    )),
    *(f"{_AGENT}/pulses/{each}.py" for each in ("filters", "finding")),
    *(f"{_NODE}/accounts/{each}.py" for each in ("gaps", "lateness", "load", "losses")),
    *(f"{_AGENT}/page/network/{each}.py" for each in (
        "listing", "source", "stream",
    )),
)  # fmt: skip
_DRIVERS = (f"{_AGENT}/devices/*/driver/emitter.py", f"{_AGENT}/devices/*/driver/*_emitter.py")


def data_rooms() -> list[Path]:
    """Return their files."""
    found = sorted({path for each in (*_PATTERNS, *_DRIVERS) for path in ROOT.glob(each)})
    return [path for path in found if path.name != "__init__.py"]


def reports_of(room: Path) -> frozenset[str]:
    """Return the methods by which a room reports: drivers have the verbs of their sink."""
    return IN_DRIVERS if "driver" in room.parts else REPORTS
