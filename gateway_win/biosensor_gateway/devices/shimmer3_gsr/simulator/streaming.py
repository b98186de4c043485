"""A virtual Shimmer3 while it streams: samples on the crystal's beat, sent in order."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from math import inf
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.shimmer3_gsr.simulator.gsr import (
    AUTO_RANGE,
    GsrAmplifier,
    conductance_us,
)
from biosensor_gateway.devices.shimmer3_gsr.simulator.inputs import (
    GSR,
    PPG,
    Conditions,
    ppg_mv,
    read,
)
from biosensor_gateway.devices.shimmer3_gsr.simulator.wire import TICKS_PER_S, data_packet
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.system.clock import Clock

_SETTLING_TICKS = round(0.065 * TICKS_PER_S)
"""What is sampled before is not sent."""
_BLOCK_S = 0.1


class Sample(NamedTuple):
    """One sample of all channels.

    Attributes
    ----------
    measured_s, leaves_s
        When it was measured and when it leaves the radio, on the LSL clock.
    packet
        Its data packet without check.
    gsr_us, gsr_range
        What the packet says of the skin conductance [uS], NaN for open electrodes, and
        with which resistor; None if it says nothing.
    ppg_mv
        What it says of the pulse probe [mV].
    """

    measured_s: float
    leaves_s: float
    packet: bytes
    gsr_us: float | None
    gsr_range: int | None
    ppg_mv: float | None


class Sampling(NamedTuple):
    """What a stream is made of.

    Attributes
    ----------
    channels
        Ids in packet order.
    divider
        Ticks between two samples.
    gsr_setting
        0 to 3 for a fixed resistor, 4 for auto-range.
    wearer, wearer_born_s
        And the LSL time at which the wearer's time is 0.
    crystal, first_tick
        And the count of ticks at its power-on.
    conditions
        Asked once a block, ten times a second.
    rng, jitter_s
        Of the radio's delay, uniform from 0 on.
    """

    channels: tuple[int, ...]
    divider: int
    gsr_setting: int
    wearer: Wearer
    wearer_born_s: float
    crystal: Crystal
    first_tick: int
    conditions: Callable[[], Conditions]
    rng: np.random.Generator
    jitter_s: float


def samples(sampling: Sampling) -> Iterator[Sample]:
    """Return the samples of a stream that starts now, without end."""
    amplifier = GsrAmplifier(sampling.gsr_setting, sampling.divider)
    start = int(sampling.crystal.now() * TICKS_PER_S)
    size = max(1, round(_BLOCK_S * TICKS_PER_S / sampling.divider))
    leaves_s = -inf
    for first in _multiples(size):
        ticks = start + sampling.divider * np.arange(first + 1, first + size + 1)
        measured = [sampling.crystal.true_time(tick / TICKS_PER_S) for tick in ticks.tolist()]
        t = np.array(measured, np.float64) - sampling.wearer_born_s
        rows = read(sampling.channels, sampling.wearer, t, sampling.conditions(), amplifier)
        delays = sampling.rng.uniform(0, sampling.jitter_s, size).tolist()
        for tick, time, row, delay in zip(ticks.tolist(), measured, rows, delays, strict=True):
            leaves_s = max(leaves_s, time + delay)
            if tick - start >= _SETTLING_TICKS:
                yield _sample(sampling, tick, time, leaves_s, row)


def _multiples(step: int) -> Iterator[int]:
    count = 0
    while True:
        yield count
        count += step


def _sample(
    sampling: Sampling, tick: int, time: float, leaves_s: float, row: tuple[int, ...]
) -> Sample:
    by_channel = dict(zip(sampling.channels, row, strict=True))
    raw, pulse, setting = by_channel.get(GSR), by_channel.get(PPG), sampling.gsr_setting
    return Sample(
        time,
        leaves_s,
        data_packet(tick + sampling.first_tick, sampling.channels, row),
        None if raw is None else conductance_us(raw, setting),
        None if raw is None else raw >> 14 if setting == AUTO_RANGE else setting,
        None if pulse is None else ppg_mv(pulse),
    )


class Streamer:
    """Sends samples when they are due; as long as the device streams, one task.

    Parameters
    ----------
    source
        Samples in order, without end.
    clock
        The true time.
    send, keep_back
        Take a sample that leaves, and one that was measured and never will.
    """

    def __init__(
        self,
        source: Iterator[Sample],
        clock: Clock,
        send: Callable[[Sample], None],
        keep_back: Callable[[Sample], None],
    ) -> None:
        self._source = source
        self._clock = clock
        self._send = send
        self._keep_back = keep_back
        self._next = next(source)
        self._stopped_s = inf
        self._task = asyncio.get_running_loop().create_task(self._run())

    @property
    def done(self) -> bool:
        """Whether it was stopped and everything has left."""
        return self._task.done()

    def stop(self) -> None:
        """Measure no more; what is on its way still arrives."""
        self._stopped_s = min(self._stopped_s, self._clock())

    def cut(self) -> None:
        """End at once; what is on its way is kept back."""
        self._task.cancel()
        stopped_s = min(self._stopped_s, self._clock())
        while not self._task.done() and self._next.measured_s <= stopped_s:
            self._keep_back(self._next)
            self._next = next(self._source)

    async def _run(self) -> None:
        while self._next.measured_s <= self._stopped_s:
            await asyncio.sleep(max(0.0, self._next.leaves_s - self._clock()))
            # It may have been stopped in the meantime.
            if self._next.measured_s <= self._stopped_s:
                sample, self._next = self._next, next(self._source)
                self._send(sample)


class Streams:
    """The stream that a device measures, and those before it of which samples still leave.

    Parameters
    ----------
    clock, send, keep_back
        As for `Streamer`.
    """

    def __init__(
        self, clock: Clock, send: Callable[[Sample], None], keep_back: Callable[[Sample], None]
    ) -> None:
        self._clock = clock
        self._send = send
        self._keep_back = keep_back
        self._streamers: list[Streamer] = []
        self._running = False

    @property
    def running(self) -> bool:
        """Whether it was started, and neither stopped nor cut since."""
        return self._running

    def start(self, source: Iterator[Sample]) -> None:
        """Send the samples of a new stream."""
        self.stop()
        self._streamers = [streamer for streamer in self._streamers if not streamer.done]
        self._streamers.append(Streamer(source, self._clock, self._send, self._keep_back))
        self._running = True

    def stop(self) -> None:
        """Measure no more; what is on its way still leaves."""
        for streamer in self._streamers:
            streamer.stop()
        self._running = False

    def cut(self) -> None:
        """End at once; what is on its way is kept back."""
        for streamer in self._streamers:
            streamer.cut()
        self._streamers.clear()
        self._running = False
