"""A wristband's radio link: its samples, measured by its crystal, on their way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import ceil, inf

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.number_format import as_sent
from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    ACC,
    BATTERY,
    BVP,
    GSR,
    HR,
    IBI,
    TAG,
    TEMPERATURE,
    Packet,
    Sample,
    Stream,
)
from biosensor_gateway.devices.empatica_e4.simulator.signals import Signals
from biosensor_gateway.simulation.crystal import Crystal

_BLOCK_S = 1 / 16
_BEAT_TICKS_HZ = 64


@dataclass(frozen=True, slots=True)
class Timing:
    """When samples leave.

    Attributes
    ----------
    burst
        Samples of GSR and of temperature that come together.
    beat_delay_s
        How late a beat's HR and IBI are.
    bvp_delay_s
        How much later than GSR and temperature BVP and acceleration come; 0.065 would
        fit what was recorded, and no client can know it.
    jitter_s
        Bound of a packet's delay by the radio.
    """

    burst: int = 6
    beat_delay_s: float = 5.6
    bvp_delay_s: float = 0.0
    battery_interval_s: float = 10.0
    jitter_s: float = 0.0


class RadioLink:
    """One radio link, from its beginning; the wristband streams from then on.

    Parameters
    ----------
    begin_s
        LSL time at which the wearer's time is 0.
    rng
        Of the radio's delays.
    arrive
        Gets each packet when it is due at the server.
    """

    def __init__(
        self,
        signals: Signals,
        crystal: Crystal,
        begin_s: float,
        timing: Timing,
        rng: np.random.Generator,
        arrive: Callable[[Packet], None],
    ) -> None:
        self._signals = signals
        self._crystal = crystal
        self._begin_s = begin_s
        self._timing = timing
        self._rng = rng
        self._arrive = arrive
        self._origin_s = crystal.now()
        self._per_packet = {BVP: 1, ACC: 1, GSR: timing.burst, TEMPERATURE: timing.burst}
        self._gathered: dict[Stream, list[Sample]] = {stream: [] for stream in self._per_packet}
        self._last_arrival_s: dict[str, float] = {}
        self._beat_tick: int | None = None
        self._battery_s = 0.0
        self._order = count()
        self._on_its_way: list[Packet] = []
        self._task = asyncio.get_running_loop().create_task(self._run())

    def end(self) -> None:
        """Measure and send no more; what is on its way does not arrive."""
        self._task.cancel()

    def tag(self) -> None:
        """Send that the button was pressed."""
        now = self._crystal.clock()
        self._dispatch((Sample(TAG, now, self._crystal.at(now) - self._origin_s, ()),), 0.0)

    async def _run(self) -> None:
        for block in count():
            self._measure(block * _BLOCK_S, (block + 1) * _BLOCK_S)
            end_s = self._true_time((block + 1) * _BLOCK_S)
            while self._on_its_way and self._on_its_way[0].arrives_s <= end_s:
                # What arrives earlier may set out meanwhile: a tag.
                await asyncio.sleep(max(0.0, self._on_its_way[0].arrives_s - self._crystal.clock()))
                self._arrive(heappop(self._on_its_way))
            await asyncio.sleep(max(0.0, end_s - self._crystal.clock()))

    def _measure(self, from_s: float, to_s: float) -> None:
        """Measure a block of device time since the link began, a moment ahead of time."""
        for stream in self._per_packet:
            self._measure_regular(stream, from_s, to_s)
        self._measure_beats(from_s, to_s)
        if from_s <= self._battery_s < to_s:
            self._send_one(BATTERY, self._battery_s, as_sent(self._signals.battery))
            self._battery_s += self._timing.battery_interval_s

    def _measure_regular(self, stream: Stream, from_s: float, to_s: float) -> None:
        rate_hz = stream.rate_hz or inf
        numbers = range(ceil(from_s * rate_hz), ceil(to_s * rate_hz))
        if not numbers:
            return
        after = [number / rate_hz for number in numbers]
        times = [self._true_time(after_s) for after_s in after]
        rows = self._signals.read(stream, np.array(times) - self._begin_s)
        gathered = self._gathered[stream]
        delay_s = self._timing.bvp_delay_s if stream in (BVP, ACC) else 0.0
        for time_s, after_s, row in zip(times, after, rows, strict=True):
            gathered.append(Sample(stream, time_s, after_s, row))
            if len(gathered) == self._per_packet[stream]:
                self._dispatch(tuple(gathered), delay_s)
                gathered.clear()

    def _measure_beats(self, from_s: float, to_s: float) -> None:
        begin, end = self._true_time(from_s), self._true_time(to_s)
        if not self._signals.is_worn:
            self._beat_tick = None
        for beat_s in self._signals.beats_between(begin - self._begin_s, end - self._begin_s):
            after_s = self._crystal.at(beat_s + self._begin_s) - self._origin_s
            tick, before = round(after_s * _BEAT_TICKS_HZ), self._beat_tick
            self._beat_tick = tick
            if before is not None:
                self._send_beat(tick / _BEAT_TICKS_HZ, (tick - before) / _BEAT_TICKS_HZ)

    def _send_beat(self, after_s: float, interval_s: float) -> None:
        measured_s = self._true_time(after_s)
        rate = Sample(HR, measured_s, after_s, (as_sent(60 / interval_s),))
        interval = Sample(IBI, measured_s, after_s, (as_sent(interval_s),))
        self._dispatch((rate, interval), self._timing.beat_delay_s)

    def _send_one(self, stream: Stream, after_s: float, *values: float) -> None:
        self._dispatch((Sample(stream, self._true_time(after_s), after_s, values),), 0.0)

    def _dispatch(self, samples: tuple[Sample, ...], delay_s: float) -> None:
        """Let samples leave when the last is measured; a stream's packets keep their order."""
        name = samples[0].stream.word
        due_s = samples[-1].measured_s + delay_s + self._rng.uniform(0, self._timing.jitter_s)
        arrives_s = max(due_s, self._last_arrival_s.get(name, due_s))
        self._last_arrival_s[name] = arrives_s
        heappush(self._on_its_way, Packet(arrives_s, next(self._order), samples))

    def _true_time(self, after_s: float) -> float:
        return self._crystal.true_time(self._origin_s + after_s)
