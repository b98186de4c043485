"""Says which streams are motion, and what BIDS calls their channels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from biosensor_common.quantities import ACCELERATION, MAGNETIC_FIELD, ORIENTATION, ContentType
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.sidecars import channel_types, columns, unit
from biosensor_gateway.recording.export.bids.tables import NOTHING

# Also what other programs call it; https://github.com/sccn/xdf/wiki/MoCap-Meta-Data.
_TYPES = {
    ContentType.ACCELEROMETER.lower(): "ACCEL",
    "accelerometry": "ACCEL",
    "acceleration": "ACCEL",
    "acc": "ACCEL",
    "gyroscope": "GYRO",
    "gyro": "GYRO",
    "magnetometer": "MAGN",
    ContentType.MOCAP.lower(): "MISC",
    "imu": "MISC",
}
_BY_ROLE = {
    **dict.fromkeys(ACCELERATION, "ACCEL"),
    **dict.fromkeys(MAGNETIC_FIELD, "MAGN"),
    **dict.fromkeys(ORIENTATION, "ORNT"),
}
# Type of a channel as other programs give it: PositionX, OrientationW, accx, Gyro Y ...
_TOLD = re.compile(r"(pos|ori|quat|acc|gyr|mag|vel)[a-z]*[ _.-]?([wxyz])", re.IGNORECASE)
_BY_WORD = {
    "pos": "POS",
    "ori": "ORNT",
    "quat": "ORNT",
    "acc": "ACCEL",
    "gyr": "GYRO",
    "mag": "MAGN",
    "vel": "VEL",
}
_HEAD = ("name", "component", "type", "tracked_point", "units")
LATENCY = "LATENCY"
_ALL_TYPES = (
    "ACCEL", "ANGACCEL", "GYRO", "JNTANG", LATENCY, "MAGN", "MISC", "ORNT", "POS", "VEL",
)  # fmt: skip


class Channel(NamedTuple):
    """A row of ``channels.tsv``."""

    name: str
    component: str
    type: str
    tracked_point: str
    units: str


def is_motion(stream: Stream) -> bool:
    """Whether a stream is of something that moves, by its type."""
    return stream.header.content_type.lower() in _TYPES


def channels(stream: Stream, timestamp: str) -> list[Channel]:
    """Return the channels of a table of motion; the first is the time of the samples."""
    meaning = stream.meaning
    point = meaning.identity.label or meaning.identity.sensor
    usual = _TYPES[stream.header.content_type.lower()]
    told = zip(
        columns(stream),
        stream.header.labels,
        channel_types(stream),
        meaning.roles,
        meaning.units,
        strict=True,
    )
    found = [Channel(timestamp, NOTHING, LATENCY, NOTHING, "s")]
    for name, label, channel_type, role, unit_name in told:
        if role is not None and role in _BY_ROLE:
            kind, axis = _BY_ROLE[role], role.value[-1]
        else:
            kind, axis = _kind(usual, label, channel_type)
        component = f"quat_{axis}" if kind == "ORNT" and axis else axis
        found.append(Channel(name, component, kind, point, unit(unit_name)))
    return found


def _kind(usual: str, label: str, channel_type: str) -> tuple[str, str]:
    """Return type and axis of a channel without a role; empty axis where nothing tells it."""
    for text in (channel_type, label):
        if match := _TOLD.fullmatch(text):
            kind, axis = _BY_WORD[match[1].lower()], match[2].lower()
            return (kind, axis) if axis != "w" or kind == "ORNT" else (kind, "")
    is_axis = label.lower() in ("x", "y", "z") and usual != "MISC"
    return usual, label.lower() if is_axis else ""


def table(found: Sequence[Channel]) -> list[tuple[str, ...]]:
    """Return ``channels.tsv``."""
    return [_HEAD, *found]


def counts(found: Sequence[Channel]) -> dict[str, int]:
    """Return the numbers of channels that ``motion.json`` tells."""
    by_type = Counter(each.type for each in found)
    return {
        **{f"{kind}ChannelCount": by_type[kind] for kind in _ALL_TYPES},
        "MotionChannelCount": len(found),
        "TrackedPointsCount": 1,
    }
