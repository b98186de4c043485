"""Streaming of a virtual Shimmer: samples at oscillator ticks, sent in order."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import inf
from typing import NamedTuple, Protocol

import numpy as np

from biosensor_gateway.devices.shimmer.simulator.wire import (
    SHIMMER3,
    TICKS_PER_S,
    Model,
    data_packet,
)
from biosensor_gateway.simulation.wearer import Floats
from biosensor_gateway.simulation.world import Oscillator
from biosensor_gateway.system.clock import Clock

# Earlier samples are not sent.
_SETTLING_TICKS = round(0.065 * TICKS_PER_S)
_BLOCK_S = 0.1


class Block(NamedTuple):
    """A block of samples measured together."""

    rows: Sequence[tuple[int, ...]]  # Counts of each sample, one per channel in packet order.
    # The same samples by data name in declared units, with one value per channel of the stream.
    values: Mapping[str, Sequence[tuple[float, ...]]]


class Meter(Protocol):
    """The sensors of one stream, with their state, such as a range."""

    def measure(self, t: Floats) -> Block:
        """Return the measurements at these times of the wearer [s]."""
        ...


class Sample(NamedTuple):
    """One sample of all channels."""

    # measured_s, leaves_s: LSL times of measurement and of sending.
    measured_s: float
    leaves_s: float
    packet: bytes  # Its data packet without checksum.
    # Contents of the packet by data name, in declared units.
    values: Mapping[str, tuple[float, ...]]


class Sampling(NamedTuple):
    """The parameters of a stream."""

    channels: tuple[int, ...]  # Channel ids in packet order.
    divider: int  # Ticks between two samples.
    meter: Meter  # Called once per block, ten times a second.
    wearer_born_s: float  # LSL time at which the wearer's time is 0.
    # oscillator, first_tick: the oscillator, and its tick count at power-on.
    oscillator: Oscillator
    first_tick: int
    # rng, jitter_s: random generator and maximum of the radio's uniform delay.
    rng: np.random.Generator
    jitter_s: float
    model: Model = SHIMMER3


def samples(sampling: Sampling) -> Iterator[Sample]:
    """Yield the samples of an endless stream that starts now."""
    start = int(sampling.oscillator.now() * TICKS_PER_S)
    size = max(1, round(_BLOCK_S * TICKS_PER_S / sampling.divider))
    leaves_s = -inf
    for first in _multiples(size):
        ticks = start + sampling.divider * np.arange(first + 1, first + size + 1)
        measured = [sampling.oscillator.true_time(tick / TICKS_PER_S) for tick in ticks.tolist()]
        block = sampling.meter.measure(np.array(measured, np.float64) - sampling.wearer_born_s)
        delays = sampling.rng.uniform(0, sampling.jitter_s, size).tolist()
        for at, tick in enumerate(ticks.tolist()):
            leaves_s = max(leaves_s, measured[at] + delays[at])
            if tick - start >= _SETTLING_TICKS:
                yield Sample(
                    measured[at],
                    leaves_s,
                    _packet(sampling, tick, block.rows[at]),
                    {name: values[at] for name, values in block.values.items()},
                )


def _multiples(step: int) -> Iterator[int]:
    count = 0
    while True:
        yield count
        count += step


def _packet(sampling: Sampling, tick: int, row: tuple[int, ...]) -> bytes:
    return data_packet(tick + sampling.first_tick, sampling.channels, row, sampling.model)


class Streamer:
    """Sends samples when due, in one task per stream.

    Parameters
    ----------
    source
        Endless samples in order.
    clock
        The true time.
    send, keep_back
        Called with a sample to send, and with a measured sample that will not be sent.
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
        """Whether it was stopped and everything was sent."""
        return self._task.done()

    def stop(self) -> None:
        """Stop measuring; samples in transit are still sent."""
        self._stopped_s = min(self._stopped_s, self._clock())

    def cut(self) -> None:
        """End at once; samples in transit are not sent."""
        self._task.cancel()
        stopped_s = min(self._stopped_s, self._clock())
        while not self._task.done() and self._next.measured_s <= stopped_s:
            self._keep_back(self._next)
            self._next = next(self._source)

    async def _run(self) -> None:
        while self._next.measured_s <= self._stopped_s:
            await asyncio.sleep(max(0.0, self._next.leaves_s - self._clock()))
            # The stream may have been stopped during the wait.
            if self._next.measured_s <= self._stopped_s:
                sample, self._next = self._next, next(self._source)
                self._send(sample)


class Streams:
    """A device's current stream, and earlier ones with samples still in transit.

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
        """Whether it was started and not yet stopped or cut."""
        return self._running

    def start(self, source: Iterator[Sample]) -> None:
        """Start a new stream."""
        self.stop()
        self._streamers = [streamer for streamer in self._streamers if not streamer.done]
        self._streamers.append(Streamer(source, self._clock, self._send, self._keep_back))
        self._running = True

    def stop(self) -> None:
        """Stop measuring; samples in transit are still sent."""
        for streamer in self._streamers:
            streamer.stop()
        self._running = False

    def cut(self) -> None:
        """End at once; samples in transit are not sent."""
        for streamer in self._streamers:
            streamer.cut()
        self._streamers.clear()
        self._running = False
