"""Packet times and battery level, for the emitters of all Shimmers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from biosensor_common.clocks import PacketTimeline
from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.shimmer.driver.calibration import ADC_MAX, ADC_VOLTS
from biosensor_gateway.devices.shimmer.driver.messages import TICKS_PER_S, BatteryReading, Packet
from biosensor_gateway.devices.shimmer.driver.protocol import TICK_MODULUS
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_DIVIDER = 1.988
_CHARGER_CHECKS_ABOVE_VOLTS = 4.5

_VOLTS = (
    3.2, 3.627, 3.645, 3.663, 3.681, 3.699, 3.717, 3.7314, 3.735, 3.7386, 3.7566, 3.771, 3.789,
    3.8034, 3.8106, 3.8394, 3.861, 3.8826, 3.9078, 3.933, 3.969, 4.0086, 4.041, 4.0734, 4.113,
    4.167,
)  # fmt: skip
_PERCENT = (
    0, 5.9, 9.8, 13.8, 17.7, 21.6, 25.6, 29.5, 33.4, 37.4, 41.3, 45.2, 49.2, 53.1, 57, 61, 64.9,
    68.9, 72.8, 76.7, 80.7, 84.6, 88.5, 92.5, 96.4, 100,
)  # fmt: skip


def battery_volts(adc: int) -> float:
    """Return the battery voltage, which is measured through a voltage divider."""
    return adc * ADC_VOLTS / ADC_MAX * _DIVIDER


def percent(volts: float) -> float:
    """Return the battery level, interpolated between the vendor's points, 0 to 100."""
    return float(np.interp(volts, _VOLTS, _PERCENT))


def charge_percent(reading: BatteryReading) -> float | None:
    """Return the battery level in percent; None while the charger tests the battery."""
    volts = battery_volts(reading.adc)
    return percent(volts) if volts <= _CHARGER_CHECKS_ABOVE_VOLTS else None


SURVIVED_AGREE_S = 1.0
"""Tolerance within which the counter of a new connection counts as not restarted. A restarted
counter is within it by chance in one of 256 cases."""


class Placed(NamedTuple):
    """The time of a packet."""

    time_s: float
    lost: int  # Number of samples lost right before it.
    # Whether the counter was restarted, so earlier times are unrelated to later ones.
    restarted: bool = False


class TickTimeline:
    """Unwraps the counter of one device, over overflows, gaps and connections.

    The counter overflows every 512 s. Arrival times show how often it did so in a gap, so a gap
    may have any length.
    """

    def __init__(self) -> None:
        self._ticks = PacketTimeline(TICK_MODULUS)
        self._arrival_s = 0.0
        self._divisor = 1
        self._is_new_connection = True

    def started(self, divisor: int) -> None:
        """Expect packets at 32768 Hz / ``divisor``."""
        self._divisor = divisor
        self._is_new_connection = True

    def place(self, ticks: int, arrival_s: float) -> Placed | None:
        """Return the time of the next packet; None for a repeated one.

        Parameters
        ----------
        ticks
            Its timestamp, 0 to 2**24 - 1.
        """
        expected = (arrival_s - self._arrival_s) * TICKS_PER_S
        step = self._ticks.steps(ticks, expected, None)
        if step == 0 and not self._is_new_connection:
            return None
        lost, restarted = (0, False) if step is None else self._judged(step, expected)
        if restarted:
            # Times continue after the restart, so that no sample seems older than the previous
            # ones.
            least = max(self._divisor, round(expected))
            self._ticks.place(ticks, least, least)
        else:
            self._ticks.place(ticks, expected, None)
        self._arrival_s = arrival_s
        self._is_new_connection = False
        return Placed((self._ticks.newest or 0) / TICKS_PER_S, lost, restarted)

    def _judged(self, step: int, expected: float) -> tuple[int, bool]:
        """Return the number of missing samples, and whether the counter was restarted."""
        agree_s = SURVIVED_AGREE_S if self._is_new_connection else LONGEST_DELAY_S
        restarted = step <= 0 or abs(step - expected) > agree_s * TICKS_PER_S
        # A restarted device has not measured in between.
        is_counted = not restarted and not self._is_new_connection
        return max(0, round(step / self._divisor) - 1) if is_counted else 0, restarted


class Batch(NamedTuple):
    """Samples of one read, oldest first."""

    rows: Sequence[tuple[int, ...]]  # Raw values of each packet, in packet order.
    times: Sequence[float]  # Device time of each packet [s].


class PacketEmitter(ABC):
    """Assigns times to a device's packets, over all connections; subclasses emit the samples.

    Parameters
    ----------
    name
        Name of the sensor, for the log.
    """

    def __init__(self, sink: DeviceSink, name: str) -> None:
        self._sink = sink
        self._log = DeviceLog(f"biosensor_gateway.{name}", sink.identity)
        self._timeline = TickTimeline()
        self._divisor: int | None = None
        self._streams: Sequence[str] = ()
        self._newest_arrival_s: float | None = None
        self._measured_until_s: float | None = None

    @abstractmethod
    def _emit(self, batch: Batch) -> None:
        """Emit the samples of a read, after the device's clock was updated."""

    def _expect(self, divisor: int, streams: Sequence[str]) -> None:
        """Prepare for packets of a new connection.

        Parameters
        ----------
        divisor
            The sampling rate is 32768 Hz divided by it.
        """
        self._divisor, self._streams = divisor, streams
        self._timeline.started(divisor)

    def kept_measuring_until(self, lsl_s: float) -> None:
        """Note until when the device probably measured without being received.

        Samples since its last packet are counted as lost, by an estimate, when the next packet
        shows that it was not switched off.

        Parameters
        ----------
        lsl_s
            LSL time when the connection was given up or the device was stopped.
        """
        self._measured_until_s = lsl_s

    def take(self, packets: Iterable[tuple[Packet, float]]) -> None:
        """Emit the samples of the packets of one read, each with its LSL time of arrival."""
        batch: list[tuple[Packet, float, float]] = []
        for packet, arrival_s in packets:
            placed = self._timeline.place(packet.ticks, arrival_s)
            if placed is None:
                self._sink.left_out(len(self._streams), "their packet came twice")
                continue
            if self._measured_until_s is not None and not placed.restarted:
                self._count_unheard(self._measured_until_s)
            self._measured_until_s = None
            if placed.restarted:
                self._pass_on(batch)
                batch = []
                self._sink.restart_clock()
            for data_name in self._streams if placed.lost else ():
                self._sink.lost(data_name, placed.lost)
            batch.append((packet, placed.time_s, arrival_s))
        self._pass_on(batch)

    def battery(self, reading: BatteryReading, arrival_s: float) -> None:
        """Emit a battery reading as ``bat``, with its arrival time."""
        level = charge_percent(reading)
        if level is not None:
            self._sink.emit_at("bat", [level], [arrival_s])

    def _count_unheard(self, until_s: float) -> None:
        if self._divisor is None or self._newest_arrival_s is None:
            return  # nothing is dropped: no packet came before the gap, from which to count
        count = round((until_s - self._newest_arrival_s) * TICKS_PER_S / self._divisor)
        if count > 0:
            for data_name in self._streams:
                self._sink.lost(data_name, count)
            # nothing is dropped: they were lost before, and are counted above
            self._log.warning("samples were lost in a gap", estimated_samples=count)

    def _pass_on(self, batch: list[tuple[Packet, float, float]]) -> None:
        if not batch or self._divisor is None:
            return  # nothing is dropped: packets come only once a rate is set
        times = [time_s for _, time_s, _ in batch]
        self._newest_arrival_s = batch[-1][2]
        self._sink.observe(times[-1], self._newest_arrival_s)
        self._emit(Batch([packet.values for packet, _, _ in batch], times))
