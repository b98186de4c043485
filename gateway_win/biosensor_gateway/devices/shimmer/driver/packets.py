"""Places a Shimmer's packets in time, and counts those that are missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from biosensor_gateway.devices.shimmer.driver.commands import TICKS_PER_S
from biosensor_gateway.devices.shimmer.driver.messages import Packet
from biosensor_gateway.devices.shimmer.driver.timeline import TickTimeline
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog


class Batch(NamedTuple):
    """Samples of one read, oldest first.

    Attributes
    ----------
    rows
        Raw values of each packet, in packet order.
    times
        Device time of each [s].
    """

    rows: Sequence[tuple[int, ...]]
    times: Sequence[float]


class PacketTimes:
    """Follows one device's packets over all its connections.

    Parameters
    ----------
    sink
    log
    emit
        Takes the samples of a read, once the clock has been told of them.
    """

    def __init__(self, sink: Sink, log: DeviceLog, emit: Callable[[Batch], None]) -> None:
        self._sink = sink
        self._log = log
        self._emit = emit
        self._timeline = TickTimeline()
        self._divisor: int | None = None
        self._streams: Sequence[str] = ()
        self._newest_arrival_s: float | None = None
        self._measured_until_s: float | None = None

    def started(self, divisor: int, streams: Sequence[str]) -> None:
        """Prepare for packets of a new connection.

        Parameters
        ----------
        divisor
            The sampling rate is 32768 Hz divided by it.
        streams
            Data names of what each packet has a sample of.
        """
        self._divisor, self._streams = divisor, streams
        self._timeline.started(divisor)

    def kept_measuring_until(self, lsl_s: float) -> None:
        """Note that the device went on measuring, as far as one knows, and was not heard.

        What it measured since its last packet is counted as lost, by an estimate, once
        the next packet shows that it was not switched off meanwhile.

        Parameters
        ----------
        lsl_s
            LSL clock when it was given up or stopped.
        """
        self._measured_until_s = lsl_s

    def take(self, packets: Iterable[tuple[Packet, float]]) -> None:
        """Emit the samples of the packets of one read, each with its LSL time of arrival."""
        batch: list[tuple[Packet, float, float]] = []
        for packet, arrival_s in packets:
            placed = self._timeline.place(packet.ticks, arrival_s)
            if placed is None:
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

    def _count_unheard(self, until_s: float) -> None:
        if self._divisor is None or self._newest_arrival_s is None:
            return
        count = round((until_s - self._newest_arrival_s) * TICKS_PER_S / self._divisor)
        if count > 0:
            for data_name in self._streams:
                self._sink.lost(data_name, count)
            self._log.warning("samples were lost in a gap", estimated_samples=count)

    def _pass_on(self, batch: list[tuple[Packet, float, float]]) -> None:
        if not batch or self._divisor is None:
            return
        times = [time_s for _, time_s, _ in batch]
        self._newest_arrival_s = batch[-1][2]
        self._sink.observe(times[-1], self._newest_arrival_s)
        self._emit(Batch([packet.values for packet, _, _ in batch], times))
