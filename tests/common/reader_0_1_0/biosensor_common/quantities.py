"""The closed sets that declarations and descriptions are made of."""

from __future__ import annotations

from enum import StrEnum, unique


@unique
class Unit(StrEnum):
    """Units as they are written into ``channels/channel/unit``."""

    ARBITRARY = "a.u."
    BEATS_PER_MINUTE = "bpm"
    BOOLEAN = "boolean"
    BREATHS_PER_MINUTE = "breaths/min"
    CELSIUS = "celsius"
    COUNTS = "counts"
    DBM = "dBm"
    DEGREES = "deg"
    FRACTION = "fraction"
    G = "g"
    INDEX = "index"
    MICROSIEMENS = "microsiemens"
    MICROTESLA = "uT"
    MICROVOLTS = "microvolts"
    MICROVOLTS_SQUARED_PER_HERTZ = "uV^2/Hz"
    MILLISECONDS = "ms"
    MILLIVOLTS = "millivolts"
    NEWTONS = "newtons"
    NONE = "none"
    PERCENT = "percent"
    SECONDS = "s"


@unique
class ContentType(StrEnum):
    """LSL content types; the case is what consumers match on."""

    ACCELEROMETER = "Accelerometer"
    ACTIVITY = "Activity"
    BATTERY = "Battery"
    COUNTERS = "Counters"
    ECG = "ECG"
    EEG = "EEG"
    EEG_BANDPOWER = "EEG-BandPower"
    GSR = "GSR"
    HR = "HR"
    HRV = "HRV"
    MARKERS = "Markers"
    MOCAP = "MoCap"
    PERFORMANCE_METRICS = "PerformanceMetrics"
    POSTURE = "Posture"
    PPG = "PPG"
    QUALITY = "Quality"
    RESPIRATION = "Respiration"
    RESPIRATION_RATE = "RespirationRate"
    RR = "RR"
    RSSI = "RSSI"
    STATUS = "Status"
    TEMPERATURE = "Temperature"


@unique
class ChannelFormat(StrEnum):
    """LSL channel formats by liblsl's own names.

    ``INT64`` is read from foreign streams only: LabRecorder drops it.
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
        """Whether the format can say "no value" in band, as NaN."""
        return self in (ChannelFormat.FLOAT32, ChannelFormat.DOUBLE64)


@unique
class Category(StrEnum):
    """The original framework's sorting of data."""

    RAW = "raw"
    HARDWARE = "hardware"
    EVENT = "event"


@unique
class MessageType(StrEnum):
    """ROS message types that a stream may name; the node accepts no other."""

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
        """Whether one message holds all channels of a sample."""
        return self.value.endswith("MultiArray")

    @property
    def is_text(self) -> bool:
        """Whether the message carries a string sample (``Empty`` only says that it came)."""
        return self in (MessageType.STRING, MessageType.EMPTY, MessageType.DIAGNOSTIC_ARRAY)

    @property
    def integer_range(self) -> tuple[int, int] | None:
        """Smallest and largest value of an integer message, None for the others."""
        return {MessageType.UINT8: (0, 255), MessageType.UINT16: (0, 65535)}.get(self)
