"""The records of a declaration, frozen and validated.

A sensor is declared once, in its folder of the agent's ``devices``. Agent, tests and documents use
that declaration; the node reads it from the stream's header. The rules that are checked here make
LabRecorder, pyxdf, MNE-LSL and rclpy accept a stream.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.quantities import (
    Category,
    ChannelFormat,
    ChannelRole,
    ContentType,
    MessageType,
)

MAX_UNIT_CHARACTERS = 32

# Characters that every XML reader, terminal and ROS tool shows unchanged.
_UNIT = re.compile(r"[!#-%(-;=?-~]+(?: [!#-%(-;=?-~]+)*")
_NAME = re.compile(r"[a-z](?:_?[a-z0-9])*")
_RESERVED_SUFFIXES = ("_chunk", "_stamped")


class FromDevice(Enum):
    """The type of :data:`FROM_DEVICE`."""

    FROM_DEVICE = "from_device"


FROM_DEVICE = FromDevice.FROM_DEVICE
"""The nominal rate is known only once the device is connected."""

IRREGULAR = 0.0
"""Nominal rate of events and of values that are sent when they change."""


@dataclass(frozen=True, slots=True)
class NominalScale:
    """How counts relate to a physical unit: ``(counts - zero) * factor``, approximately."""

    factor: float
    unit: str
    zero: float = 0.0


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """One channel of a stream.

    Attributes
    ----------
    unit
        A :class:`.Unit`, or any unit for a sensor of another package.
    scale
        Set if ``unit`` is counts and a datasheet gives a factor.
    role
        Meaning of the values for agent and node; None if neither uses them.
    plausible
        Lowest and highest possible value in `unit`; values outside are not sent. A text says
        why there are no bounds; None for a unit that is not physical.
    may_rest
        Whether it may have one value for long although its stream is a signal of the body: light of
        a dark room, an input to which nothing is connected.

    Raises
    ------
    SpecError
        ``INVALID``, with the channel and the rule that it breaks.
    """

    label: str
    unit: str
    scale: NominalScale | None = None
    role: ChannelRole | None = None
    plausible: tuple[float, float] | str | None = None
    may_rest: bool = False

    def __post_init__(self) -> None:
        units = [self.unit] if self.scale is None else [self.unit, self.scale.unit]
        for unit in units:
            if len(unit) > MAX_UNIT_CHARACTERS or _UNIT.fullmatch(unit) is None:
                rule = (
                    f"its unit {unit[: 2 * MAX_UNIT_CHARACTERS]!r} is not 1 to "
                    f"{MAX_UNIT_CHARACTERS} characters of ASCII without quotes, <, > and &"
                )
                raise SpecError(SpecReason.INVALID, f"channel {self.label!r}: {rule}")
        if self.role is not None and self.unit != self.role.unit:
            rule = f"the role {self.role} requires the unit {self.role.unit}, not {self.unit}"
            raise SpecError(SpecReason.INVALID, f"channel {self.label!r}: {rule}")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            rule = f"between {self.bounds[0]:g} and {self.bounds[1]:g} there is no value"
            raise SpecError(SpecReason.INVALID, f"channel {self.label!r}: {rule}")

    @property
    def bounds(self) -> tuple[float, float] | None:
        """Lowest and highest plausible value; None without bounds."""
        return self.plausible if isinstance(self.plausible, tuple) else None


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """One LSL stream and the ROS topics that it fills.

    Attributes
    ----------
    data_name
        Last part of the topic, e.g. ``ecg``.
    rate
        Nominal rate in Hz; ``IRREGULAR`` (0) or ``FROM_DEVICE``.
    chunk
        Data name of the chunk topic (``<chunk>_chunk``) and of the parameters
        that set it; empty where the stream has no chunks.
    contract
        Whether the original framework has this topic: then its name and message type
        never change.
    is_state
        Whether each sample is valid until the next one, so that late subscribers need the last.

    Raises
    ------
    SpecError
        ``INVALID``, with the stream and the rule that it breaks.
    """

    data_name: str
    category: Category
    content_type: ContentType
    channels: tuple[ChannelSpec, ...]
    rate: float | FromDevice
    format: ChannelFormat
    message_type: MessageType
    chunk: str = ""
    contract: bool = False
    is_state: bool = False

    def __post_init__(self) -> None:
        for broken, rule in self._rules():
            if broken:
                raise SpecError(SpecReason.INVALID, f"stream {self.data_name!r}: {rule}")

    def _rules(self) -> list[tuple[bool, str]]:
        is_text = self.format is ChannelFormat.STRING
        labels = [channel.label for channel in self.channels]
        roles = [channel.role for channel in self.channels if channel.role is not None]
        return [
            (not is_data_name(self.data_name), "its name is not a lower-case ROS name"),
            (not self.channels, "it has no channel"),
            (len(set(labels)) != len(labels) or "" in labels, "labels are empty or repeated"),
            (not "".join(labels).isascii(), "labels must be ASCII"),
            (len(set(roles)) != len(roles), "two channels have the same role"),
            (self.is_state and self.is_regular, "a state has no rate"),
            (
                not (self.is_from_device or self._rate_is_valid()),
                "its rate is negative or infinite",
            ),
            (self.format is ChannelFormat.INT64, "LabRecorder drops int64 streams"),
            (is_text != self.message_type.is_text, "format and message type do not fit"),
            (
                len(labels) > 1 and not self.message_type.is_array,
                f"{self.message_type} holds one channel",
            ),
            (bool(self.chunk) and not is_data_name(self.chunk), "its chunk name is not a ROS name"),
            (bool(self.chunk) and is_text, "text has no chunks"),
            (bool(self.chunk) and self.rate == IRREGULAR, "an irregular stream has no chunks"),
        ]

    def _rate_is_valid(self) -> bool:
        return not isinstance(self.rate, FromDevice) and 0 <= self.rate < float("inf")

    @property
    def is_from_device(self) -> bool:
        """Whether the rate is known only once the device is connected."""
        return self.rate is FROM_DEVICE

    @property
    def is_regular(self) -> bool:
        """Whether samples are equidistant."""
        return self.rate != IRREGULAR

    @property
    def labels(self) -> tuple[str, ...]:
        """Channel labels in channel order."""
        return tuple(channel.label for channel in self.channels)


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """All streams of one kind of sensor.

    Raises
    ------
    SpecError
        ``INVALID``, if the name is not a ROS name or two streams share a topic.
    """

    name: str
    title: str
    manufacturer: str
    model: str
    streams: tuple[StreamSpec, ...]

    def __post_init__(self) -> None:
        if not is_data_name(self.name):
            raise SpecError(SpecReason.INVALID, f"sensor {self.name!r}: not a lower-case ROS name")
        topics = [stream.data_name for stream in self.streams]
        topics += [f"{stream.chunk}_chunk" for stream in self.streams if stream.chunk]
        if len(set(topics)) != len(topics):
            raise SpecError(SpecReason.INVALID, f"sensor {self.name!r}: two streams share a topic")

    def stream(self, data_name: str) -> StreamSpec:
        """Return the stream of that name.

        Raises
        ------
        KeyError
            If the sensor has no such stream.
        """
        for stream in self.streams:
            if stream.data_name == data_name:
                return stream
        raise KeyError(data_name)

    def rates(self, reported: Mapping[str, float]) -> dict[str, float]:
        """Return the streams' nominal rates in Hz by data name; the device *reported* some."""
        rates = {each.data_name: reported.get(each.data_name, each.rate) for each in self.streams}
        return {name: rate for name, rate in rates.items() if not isinstance(rate, FromDevice)}

    def channels_of(self, role: ChannelRole) -> Iterator[tuple[str, int, str]]:
        """Yield data name, column and label of each channel that has a role."""
        for stream in self.streams:
            for column, channel in enumerate(stream.channels):
                if channel.role is role:
                    yield stream.data_name, column, channel.label


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Identity of one device: its unit, wearer and place on the body.

    Attributes
    ----------
    unit
        Serial number of the device, else its port or address.
    participant
        Pseudonym of the person who wears it (``p01``), or empty.
    label
        Distinguishes two devices of one kind on a person (``left``), or empty.
    """

    sensor: str
    unit: str
    participant: str = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Facts that the device reports, for ``desc/acquisition``; empty where unknown."""

    manufacturer: str = ""
    model: str = ""
    serial_number: str = ""
    firmware_version: str = ""


def is_data_name(text: str) -> bool:
    """Whether *text* is a lower-case ROS token that ends in no reserved suffix."""
    return _NAME.fullmatch(text) is not None and not text.endswith(_RESERVED_SUFFIXES)
