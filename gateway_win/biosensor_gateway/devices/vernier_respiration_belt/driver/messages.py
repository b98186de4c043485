"""A belt's messages, as records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, unique
from typing import TypeAlias


@unique
class MeasurementKind(IntEnum):
    """Fifth byte of a measurement packet."""

    NORMAL_REAL32 = 0x06
    WIDE_REAL32 = 0x07
    SINGLE_REAL32 = 0x08
    SINGLE_INT32 = 0x09
    APERIODIC_REAL32 = 0x0A
    APERIODIC_INT32 = 0x0B
    START_TIME = 0x0C
    DROPPED = 0x0D
    PERIOD = 0x0E


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a command.

    Attributes
    ----------
    counter
        The device's packet counter, 0 to 255.
    command
        Id of the command that is answered.
    echo
        Counter of the command that is answered.
    payload
    """

    counter: int
    command: int
    echo: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Measurement:
    """Samples of one or several channels, oldest first.

    Attributes
    ----------
    counter
        The device's packet counter, 0 to 255.
    kind
    samples
        By channel number, in the channel's unit; NaN is "no value". All channels
        have the same number of samples.
    """

    counter: int
    kind: MeasurementKind
    samples: Mapping[int, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Notice:
    """Start time, period, or that the device dropped samples; the content is not documented."""

    counter: int
    kind: MeasurementKind


@dataclass(frozen=True, slots=True)
class Unknown:
    """A packet that cannot be decoded; its bytes count as dropped."""

    counter: int


Message: TypeAlias = Reply | Measurement | Notice | Unknown
