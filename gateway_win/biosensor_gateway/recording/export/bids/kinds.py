"""Determines the kind of signal of a stream by its LSL type, for its place in BIDS."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto, unique

from biosensor_common.quantities import ContentType
from biosensor_gateway.recording.contents.stream import Stream


@unique
class Kind(Enum):
    """Kinds of signals for which BIDS has separate folders or sidecars."""

    EEG = auto()
    EMG = auto()
    GAZE = auto()
    MOTION = auto()
    OTHER = auto()


# Includes types of other programs; https://github.com/sccn/xdf/wiki/MoCap-Meta-Data.
_MOTION_TYPES: Mapping[str, str] = {
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
_BY_TYPE: Mapping[str, Kind] = {
    "eeg": Kind.EEG,
    "emg": Kind.EMG,
    **dict.fromkeys(("gaze", "eyetracking", "eyetracker", "eyetrack"), Kind.GAZE),
    **dict.fromkeys(_MOTION_TYPES, Kind.MOTION),
}


def kind_of(stream: Stream) -> Kind:
    """Return the kind of a stream; case, spaces, hyphens and underscores are ignored."""
    return _BY_TYPE.get(_plain(stream), Kind.OTHER)


def motion_type(stream: Stream) -> str:
    """Return the usual BIDS channel type of a motion stream."""
    return _MOTION_TYPES[_plain(stream)]


def _plain(stream: Stream) -> str:
    return "".join(each for each in stream.header.content_type.lower() if each.isalnum())
