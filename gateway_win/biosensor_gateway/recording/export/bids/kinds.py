"""Says what kind of signal a stream is, by its LSL type, and so where BIDS has its place."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto, unique

from biosensor_common.quantities import ContentType
from biosensor_gateway.recording.contents.stream import Stream


@unique
class Kind(Enum):
    """What BIDS has folders or sidecars of their own for."""

    EEG = auto()
    EMG = auto()
    GAZE = auto()
    MOTION = auto()
    OTHER = auto()


# Also what other programs call it; https://github.com/sccn/xdf/wiki/MoCap-Meta-Data.
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
    """Return the kind of a stream; capitals, blanks, hyphens and underscores do not count."""
    return _BY_TYPE.get(_plain(stream), Kind.OTHER)


def motion_type(stream: Stream) -> str:
    """Return what the channels of a stream of motion usually are, in the words of BIDS."""
    return _MOTION_TYPES[_plain(stream)]


def _plain(stream: Stream) -> str:
    return "".join(each for each in stream.header.content_type.lower() if each.isalnum())
