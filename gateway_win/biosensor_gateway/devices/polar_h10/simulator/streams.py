"""One running measurement: samples of the wearer, in frames, at the device's pace."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from bumble.gatt import Characteristic

from biosensor_gateway.devices.ble_heart_rate.simulator.heart import BeatDetector
from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import RR_TICKS_PER_S
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.devices.polar_h10.simulator import frames
from biosensor_gateway.devices.polar_h10.simulator.delta import Integers
from biosensor_gateway.devices.polar_h10.simulator.frames import PulseInterval
from biosensor_gateway.devices.polar_h10.simulator.pmd import ATT_HEADER_BYTES, FULL_MTU
from biosensor_gateway.devices.polar_h10.simulator.waveforms import Waveform

POWER_ON_NS = 599_616_000_000_000_000
"""What the device's clock shows at power-on, in ns since 2000: the year 2019."""
_INTERVAL_PERIOD_S = 5
_INTERVAL_BYTES = 6
_INTERVAL_ERROR_MS = 8


class MeasurementStream(Protocol):
    """A measurement that is on."""

    async def run(self) -> None:
        """Measure and send for ever."""
        ...

    def end(self) -> None:
        """Account for what was measured and not sent, once `run` is cancelled."""
        ...


class WaveformStream:
    """Samples at a constant rate.

    Parameters
    ----------
    strap
        Who measures.
    data
        The characteristic that carries the frames.
    waveform
        What is measured.
    rate_hz
        The true rate, in the device's time.
    begin_s
        Device time of the first sample [s since power-on].
    """

    def __init__(
        self,
        strap: Strap,
        data: Characteristic[bytes],
        waveform: Waveform,
        rate_hz: float,
        begin_s: float,
    ) -> None:
        self._strap = strap
        self._crystal = strap.crystal
        self._data = data
        self._waveform = waveform
        self._rate_hz = rate_hz
        self._begin_s = begin_s
        self._next = 0

    async def run(self) -> None:
        """Measure and send for ever."""
        while True:
            count = self._waveform.planned(_room(self._strap))
            await self._crystal.reach(self._device_s(self._next + count - 1))
            await self._send(count)

    def end(self) -> None:
        """Account for the frame that was begun."""
        measured = int((self._crystal.now() - self._begin_s) * self._rate_hz) + 1
        self._strap.truth.unsent(self._waveform.data_name, max(0, measured - self._next))

    async def _send(self, count: int) -> None:
        indices = np.arange(self._next, self._next + count)
        begin_s, end_s = (self._crystal.true_time(self._device_s(int(i))) for i in indices[[0, -1]])
        times = np.linspace(begin_s, end_s, count)
        stamps = [POWER_ON_NS + round(1e9 * self._device_s(int(index))) for index in indices]
        counts = self._waveform.counts(times - self._strap.origin_s, self._strap.worn)
        for part, frame in self._waveform.split(counts, stamps, _room(self._strap)):
            sent = await _send(self._strap, self._data, frame)
            self._note(times[: len(part)].tolist(), part, sent=sent)
            times = times[len(part) :]

    def _note(self, times: list[float], counts: Integers, *, sent: bool) -> None:
        self._next += len(times)
        if sent:
            values = (counts * self._waveform.unit).tolist()
            self._strap.truth.sent(self._waveform.data_name, times, values)
        elif self._strap.peripheral.connected:
            self._strap.truth.unsent(self._waveform.data_name, len(times))

    def _device_s(self, index: int) -> float:
        return self._begin_s + index / self._rate_hz


class IntervalStream:
    """Pulse-to-pulse intervals with their errors, every five seconds, without a time.

    Parameters
    ----------
    strap
        Who measures.
    data
        The characteristic that carries the frames.
    first_s
        Device time of the first ones [s since power-on].
    """

    def __init__(self, strap: Strap, data: Characteristic[bytes], first_s: float) -> None:
        self._strap = strap
        self._data = data
        self._next_s = first_s
        now_s = strap.crystal.clock()
        self._detector = BeatDetector(strap.wearer, strap.crystal, strap.origin_s, now_s)

    async def run(self) -> None:
        """Measure and send for ever."""
        while True:
            await self._send(await self._strap.crystal.reach(self._next_s))
            self._next_s += _INTERVAL_PERIOD_S

    def end(self) -> None:
        """Intervals since the last frame were not evaluated yet: nothing is missing."""

    async def _send(self, until_s: float) -> None:
        if not self._strap.worn:
            self._detector.lose(until_s)
            return
        self._detector.begin_at(self._strap.put_on_s)
        intervals = self._detector.search(until_s)
        lengths_ms = [round(1000 * one.rr / RR_TICKS_PER_S) for one in intervals]
        per_frame = (_room(self._strap) - frames.HEADER_BYTES) // _INTERVAL_BYTES
        for at in range(0, len(intervals), per_frame):
            part = slice(at, at + per_frame)
            entries = [
                PulseInterval(self._detector.bpm, length, _INTERVAL_ERROR_MS, contact=True)
                for length in lengths_ms[part]
            ]
            if await _send(self._strap, self._data, frames.pulse_intervals(0, entries)):
                times = [one.time for one in intervals[part]]
                values = [(each / 1000, _INTERVAL_ERROR_MS / 1000) for each in lengths_ms[part]]
                self._strap.truth.sent("ppi", times, values)


async def _send(strap: Strap, data: Characteristic[bytes], frame: bytes) -> bool:
    """Send a frame; False if nobody can know what it holds."""
    if strap.is_unreadable:
        await strap.send(data, frames.in_unknown_format(frame))
        return False
    return await strap.send(data, frame)


def _room(strap: Strap) -> int:
    return min(strap.peripheral.host_mtu, FULL_MTU) - ATT_HEADER_BYTES
