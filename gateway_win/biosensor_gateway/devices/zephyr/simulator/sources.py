"""Sources of a virtual BioHarness's values: a recording, or a wearer.

A source knows neither port nor host. It is asked, with the time on the LSL clock, for the
frames that are due.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from biosensor_gateway.devices.zephyr.simulator.inputs import Integers
from biosensor_gateway.devices.zephyr.simulator.vitals import Values
from biosensor_gateway.devices.zephyr.simulator.wire import DeviceStamp, Packet
from biosensor_gateway.system.clock import Clock


@dataclass(frozen=True, eq=False)
class Outgoing:
    """One frame of a source, with what it holds.

    Attributes
    ----------
    data
        The frame's bytes; for recorded junk whatever was there.
    packet
        Its kind; None for junk and message ids that the project does not know.
    sequence
        Packet number since power-on, not wrapped; the frame holds its low 8 bits.
    stamp
        The device's clock as the frame says it.
    measured_at
        When its first sample (or, for a summary, the whole) was measured, on the LSL
        clock [s].
    period_s
        True time between two of its samples [s].
    first_index
        Number of its first sample since power-on.
    samples
        Shape (samples, channels); as `Inputs.samples` returns them.
    values
        Fields of a summary or general data packet.
    """

    data: bytes
    packet: Packet | None = None
    sequence: int | None = None
    stamp: DeviceStamp | None = None
    measured_at: float | None = None
    period_s: float | None = None
    first_index: int | None = None
    samples: Integers | None = None
    values: Values | None = None


class Source(Protocol):
    """Gives frames when they are due; all times are seconds on the LSL clock."""

    @property
    def speaks_lifesigns(self) -> bool:
        """Whether its frames include the device's lifesigns at present."""
        ...

    def power_on(self, clock: Clock) -> None:
        """Begin to measure, by this clock."""
        ...

    def poll(self, now: float, enabled: frozenset[Packet]) -> Iterable[Outgoing]:
        """Return the frames that became due; of periodic packets the enabled ones."""
        ...

    def next_due(self) -> float:
        """Return when `poll` is worth calling again."""
        ...

    def hangs_up(self, now: float) -> bool:
        """Tell whether the device ends the connection by itself."""
        ...

    def connection_ended(self) -> None:
        """Hear that the host is gone."""
        ...
