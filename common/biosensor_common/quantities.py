"""Closed sets for declarations and descriptions: units, formats, message types, roles."""

from __future__ import annotations

from enum import StrEnum, unique
from math import ceil


@unique
class Unit(StrEnum):
    """Units of our declarations, as written into ``channels/channel/unit``.

    A sensor of another package may have other units; see :class:`.ChannelSpec`.
    """

    ARBITRARY = "a.u."
    BEATS_PER_MINUTE = "bpm"
    BOOLEAN = "boolean"
    BREATHS_PER_MINUTE = "breaths/min"
    CELSIUS = "celsius"
    COUNTS = "counts"
    DBM = "dBm"
    DEGREES = "deg"
    DEGREES_PER_SECOND = "deg/s"
    FRACTION = "fraction"
    G = "g"
    INDEX = "index"
    LOCAL_FLUX = "local_flux"
    """Relative to the magnetic field at the place of calibration."""
    METRES_PER_SECOND = "m/s"
    MICROSIEMENS = "microsiemens"
    MICROTESLA = "uT"
    MICROVOLTS = "microvolts"
    MICROVOLTS_SQUARED_PER_HERTZ = "uV^2/Hz"
    MILLISECONDS = "ms"
    MILLIVOLTS = "millivolts"
    NEWTONS = "newtons"
    NONE = "none"
    OHMS = "ohm"
    PASCALS = "Pa"
    PERCENT = "percent"
    REVOLUTIONS_PER_MINUTE = "rpm"
    SECONDS = "s"
    WATTS = "W"


@unique
class ChannelRole(StrEnum):
    """Meaning of a channel for programs that use its values, independent of its label.

    The role fixes the unit, see `unit`. Most channels have no role, because only the
    person who reads the recording needs their meaning.
    """

    CONTACT = "contact"
    """1 while the sensor is worn correctly, 0 while it is off the body, NaN if unknown."""
    STATE_OF_CHARGE = "state_of_charge"
    """Charge of the battery."""
    SIGNAL_STRENGTH = "signal_strength"
    """Signal strength of the radio, measured by the receiver."""
    ORIENTATION_W = "orientation_w"
    """The scalar part of a unit quaternion."""
    ORIENTATION_X = "orientation_x"
    ORIENTATION_Y = "orientation_y"
    ORIENTATION_Z = "orientation_z"
    ACCELERATION_X = "acceleration_x"
    ACCELERATION_Y = "acceleration_y"
    ACCELERATION_Z = "acceleration_z"
    MAGNETIC_FIELD_X = "magnetic_field_x"
    MAGNETIC_FIELD_Y = "magnetic_field_y"
    MAGNETIC_FIELD_Z = "magnetic_field_z"

    @property
    def unit(self) -> Unit:
        """Unit of every channel with this role."""
        return _ROLE_UNITS[self]


ORIENTATION = (
    ChannelRole.ORIENTATION_W,
    ChannelRole.ORIENTATION_X,
    ChannelRole.ORIENTATION_Y,
    ChannelRole.ORIENTATION_Z,
)
ACCELERATION = (
    ChannelRole.ACCELERATION_X,
    ChannelRole.ACCELERATION_Y,
    ChannelRole.ACCELERATION_Z,
)
MAGNETIC_FIELD = (
    ChannelRole.MAGNETIC_FIELD_X,
    ChannelRole.MAGNETIC_FIELD_Y,
    ChannelRole.MAGNETIC_FIELD_Z,
)

_ROLE_UNITS: dict[ChannelRole, Unit] = {
    ChannelRole.CONTACT: Unit.BOOLEAN,
    ChannelRole.STATE_OF_CHARGE: Unit.PERCENT,
    ChannelRole.SIGNAL_STRENGTH: Unit.DBM,
    **dict.fromkeys(ORIENTATION, Unit.NONE),
    **dict.fromkeys(ACCELERATION, Unit.G),
    **dict.fromkeys(MAGNETIC_FIELD, Unit.MICROTESLA),
}

ROLES_OF_DEVICE = frozenset(
    {ChannelRole.CONTACT, ChannelRole.STATE_OF_CHARGE, ChannelRole.SIGNAL_STRENGTH}
)
"""Roles of channels about the device, not the person."""


@unique
class ContentType(StrEnum):
    """LSL content types; programs match them case-sensitively."""

    ACCELEROMETER = "Accelerometer"
    ACTIVITY = "Activity"
    BATTERY = "Battery"
    COUNTERS = "Counters"
    ECG = "ECG"
    EEG = "EEG"
    EEG_BANDPOWER = "EEG-BandPower"
    EMG = "EMG"
    GSR = "GSR"
    GYROSCOPE = "Gyroscope"
    HR = "HR"
    HRV = "HRV"
    MAGNETOMETER = "Magnetometer"
    MARKERS = "Markers"
    MISC = "Misc"
    """Data of a user's own device for which there is no other type."""
    MOCAP = "MoCap"
    OXIMETRY = "Oximetry"
    PERFORMANCE_METRICS = "PerformanceMetrics"
    POSTURE = "Posture"
    PPG = "PPG"
    PRESSURE = "Pressure"
    QUALITY = "Quality"
    RESPIRATION = "Respiration"
    RESPIRATION_RATE = "RespirationRate"
    RR = "RR"
    RSSI = "RSSI"
    STATUS = "Status"
    TEMPERATURE = "Temperature"


_SPELT = {
    **{each.value.casefold(): each for each in ContentType},
    "acc": ContentType.ACCELEROMETER,
    "eda": ContentType.GSR,
    "resp": ContentType.RESPIRATION,
}


def spellings(content_type: ContentType) -> set[str]:
    """Return usual spellings of a type, for a search that compares exactly."""
    names = [each for each, known in _SPELT.items() if known is content_type]
    return {content_type.value, *names, *(each.upper() for each in names)}


def signal_type(content_type: str) -> str:
    """Return the type of a signal as it is called here, however another program spells it."""
    return _SPELT.get(content_type.strip().casefold(), content_type)


TYPES_OF_DEVICE = frozenset(
    {ContentType.BATTERY, ContentType.QUALITY, ContentType.RSSI, ContentType.STATUS}
)
"""Types of streams about the device, not the person."""


CONSTANT_S = {
    ContentType.ECG: 10.0,
    ContentType.EEG: 10.0,
    ContentType.EMG: 10.0,
    ContentType.PPG: 10.0,
    ContentType.GSR: 60.0,
    ContentType.RESPIRATION: 60.0,
}
"""How long a channel of a regular stream of this type may have one value, in s.

A body changes such a signal, and noise its last digit: one that stands still for longer comes from
a dead electrode, a cable or a converter. Of other types a value may be right for as long as it
likes: a charge, a count, the acceleration of a sensor with few digits that lies still.
"""
_NAMES_OF_OTHERS = {"EDA": ContentType.GSR, "RESP": ContentType.RESPIRATION, "BVP": ContentType.PPG}


def constant_s(content_type: str) -> float | None:
    """Return the limit of `CONSTANT_S` for a content type of any program; None without one."""
    known = {each.value.upper(): each for each in CONSTANT_S} | _NAMES_OF_OTHERS
    found = known.get(content_type.upper())
    return None if found is None else CONSTANT_S[found]


def waits_for_receivers(content_type: str, *, is_regular: bool, is_state: bool) -> bool:
    """Whether an outlet buffers its samples, with their stamps, until the first receiver connects.

    Such a stream may begin long before the recording that contains it.
    """
    return not is_regular and (is_state or content_type in TYPES_OF_DEVICE)


@unique
class ChannelFormat(StrEnum):
    """LSL channel formats by liblsl's own names.

    ``INT64`` is accepted from foreign streams only, because LabRecorder drops it.
    """

    FLOAT32 = "float32"
    DOUBLE64 = "double64"
    STRING = "string"
    INT32 = "int32"
    INT16 = "int16"
    INT8 = "int8"
    INT64 = "int64"

    @property
    def is_float(self) -> bool:
        """Whether the format has NaN for a missing value."""
        return self in (ChannelFormat.FLOAT32, ChannelFormat.DOUBLE64)


@unique
class Category(StrEnum):
    """The original framework's categories of data."""

    RAW = "raw"
    HARDWARE = "hardware"
    EVENT = "event"


@unique
class MessageType(StrEnum):
    """ROS message types that a stream may name; the node rejects all others."""

    DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
    EMPTY = "std_msgs/msg/Empty"
    FLOAT32 = "std_msgs/msg/Float32"
    FLOAT32_MULTI_ARRAY = "std_msgs/msg/Float32MultiArray"
    FLOAT64_MULTI_ARRAY = "std_msgs/msg/Float64MultiArray"
    INT32_MULTI_ARRAY = "std_msgs/msg/Int32MultiArray"
    INT64_MULTI_ARRAY = "std_msgs/msg/Int64MultiArray"
    STRING = "std_msgs/msg/String"
    UINT8 = "std_msgs/msg/UInt8"
    UINT16 = "std_msgs/msg/UInt16"

    @property
    def is_array(self) -> bool:
        """Whether one message has all channels of a sample."""
        return self.value.endswith("MultiArray")

    @property
    def is_text(self) -> bool:
        """Whether the message carries a string sample (``Empty`` carries only its arrival)."""
        return self in (MessageType.STRING, MessageType.EMPTY, MessageType.DIAGNOSTIC_ARRAY)

    @property
    def integer_range(self) -> tuple[int, int] | None:
        """Smallest and largest value of an integer message; None for other types."""
        return {MessageType.UINT8: (0, 255), MessageType.UINT16: (0, 65535)}.get(self)


STANDARD_GRAVITY = 9.80665
"""In m/s², exactly (3rd General Conference on Weights and Measures, 1901)."""


# When a network loses packets or fails for some seconds, messages to be sent again must
# still be there; measured with 5 % of all packets lost and with a cut of 6 s.
DEPTH_S = 30.0
MIN_RATE_HZ, MAX_DEPTH = 10.0, 100_000

_WIDE = frozenset(
    {
        MessageType.FLOAT64_MULTI_ARRAY,
        MessageType.INT32_MULTI_ARRAY,
        MessageType.INT64_MULTI_ARRAY,
    }
)


def piece_messages(rate: float) -> int:
    """Return how many messages of a topic with this rate in Hz fill half of its queue."""
    return queue_depth(rate) // 2


def queue_depth(rate: float) -> int:
    """Return the queue depth of a topic with this rate in Hz, 0 for an irregular one."""
    # A foreign stream may announce any rate.
    return ceil(min(max(rate, MIN_RATE_HZ) * DEPTH_S, MAX_DEPTH))


def chunk_type(raw: MessageType) -> MessageType:
    """Return the message type of a stream's chunks, which keeps the precision of its raw type."""
    return raw if raw in _WIDE else MessageType.FLOAT32_MULTI_ARRAY
