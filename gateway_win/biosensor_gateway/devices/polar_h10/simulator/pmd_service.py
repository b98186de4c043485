"""The PMD service on the air: control point, data, and the measurements that run."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from itertools import cycle
from typing import Protocol

import numpy as np
from bumble.att import ATT_Error, Attribute, ErrorCode
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.heart import BeatDetector
from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import RR_TICKS_PER_S
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.devices.polar_h10.simulator import frames, pmd
from biosensor_gateway.devices.polar_h10.simulator.control_point import ControlPoint
from biosensor_gateway.devices.polar_h10.simulator.frames import Integers, PulseInterval
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ATT_HEADER_BYTES,
    FULL_MTU,
    Measurement,
)
from biosensor_gateway.devices.polar_h10.simulator.products import Product
from biosensor_gateway.devices.polar_h10.simulator.quirks import Quirks
from biosensor_gateway.devices.polar_h10.simulator.waveforms import Waveform, waveform

_Permissions = Attribute.Permissions
_Properties = Characteristic.Properties
_PULSE_WITH_INTERVALS_S = 5

POWER_ON_NS = 599_616_000_000_000_000
"""What the device's clock shows at power-on, in ns since 2000: the year 2019."""
_INTERVAL_PERIOD_S = 5
_INTERVAL_BYTES = 6
_INTERVAL_ERROR_MS = 8


class _MeasurementStream(Protocol):
    """A measurement that is on."""

    async def run(self) -> None:
        """Measure and send for ever."""
        ...

    def end(self) -> None:
        """Account for what was measured and not sent, once `run` is cancelled."""
        ...


class _WaveformStream:
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


class _IntervalStream:
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


class PmdService:
    """Adds measurement data to a strap.

    Parameters
    ----------
    strap
        Gets the service; must not be switched on yet.
    product, quirks
        What can be measured, and how.

    Attributes
    ----------
    answer_delay_s
        Every command is answered so late.
    """

    def __init__(self, strap: Strap, product: Product, quirks: Quirks) -> None:
        self._to_deny = cycle(product.settings)
        self._control = ControlPoint(
            product,
            running=quirks.left_streaming,
            minimum_mtu=quirks.minimum_mtu,
            short_errors=quirks.short_errors,
            announces_stops=quirks.announces_stops,
        )
        self.answer_delay_s = 0.0
        self._strap = strap
        self._product = product
        self._quirks = quirks
        self._conversation = asyncio.Lock()
        self._answers: set[asyncio.Task[None]] = set()
        self._streams: dict[Measurement, tuple[_MeasurementStream, asyncio.Task[None]]] = {}
        self._control_point = self._describe_control_point()
        self._data = Characteristic[bytes](
            pmd.DATA_UUID, _Properties.NOTIFY, _Permissions.READABLE, b""
        )
        strap.services.append(Service(pmd.SERVICE_UUID, [self._control_point, self._data]))
        strap.on_power_on.append(self._begin_streams)
        strap.on_power_off.append(self.forget)
        strap.peripheral.on_disconnected.append(self._lose_host)

    async def stop(self, measurements: Iterable[Measurement]) -> None:
        """Stop measurements on the device's own account and say so."""
        packet = self._control.stop(measurements)
        self._end_streams()
        await self._strap.peripheral.notify(self._control_point, packet)

    def deny(self) -> None:
        """Start one of its measurements no more, another one at each time."""
        self._control.denied = frozenset({next(self._to_deny)})

    def give(self) -> None:
        """Start each again."""
        self._control.denied = frozenset()

    @property
    def refuses(self) -> bool:
        """Whether every command is refused."""
        return self._control.refuses

    @refuses.setter
    def refuses(self, refuses: bool) -> None:
        self._control.refuses = refuses

    def babble(self, packets: float) -> None:
        """Send so many damaged frames."""
        self._strap.run(self._send_garbage(round(packets)))

    def forget(self) -> None:
        """Stop all measurements without a word."""
        self._control.running.clear()
        self._end_streams()

    async def _send_garbage(self, packets: int) -> None:
        for frame in frames.damaged(self._strap.rng, packets):
            await self._strap.peripheral.notify(self._data, frame)

    def _describe_control_point(self) -> Characteristic[bytes]:
        features = pmd.encode_features(self._product.features)
        return Characteristic(
            pmd.CONTROL_POINT_UUID,
            _Properties.READ | _Properties.WRITE | _Properties.INDICATE,
            _Permissions.READABLE
            | _Permissions.WRITEABLE
            | _Permissions.WRITE_REQUIRES_AUTHENTICATION,
            CharacteristicValue(read=lambda _connection: features, write=self._hear),
        )

    def _hear(self, _connection: Connection, command: bytes) -> None:
        if not self._strap.peripheral.subscribed(self._control_point):
            raise ATT_Error(ErrorCode.CCCD_IMPROPERLY_CONFIGURED)
        # The indication must come after the response to this write.
        task = self._strap.run(self._answer(command))
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def _answer(self, command: bytes) -> None:
        async with self._conversation:
            await asyncio.sleep(self.answer_delay_s)
            packets = self._control.answer(command, self._strap.peripheral.host_mtu)
            self._end_streams()
            for packet in packets:
                await self._strap.peripheral.notify(self._control_point, packet)
            self._begin_streams()

    def _begin_streams(self) -> None:
        self._choose_pace()
        for measurement in self._control.running.keys() - self._streams.keys():
            if measurement in self._product.settings:
                stream = self._stream(measurement)
                self._streams[measurement] = stream, self._strap.run(stream.run())

    def _stream(self, measurement: Measurement) -> _MeasurementStream:
        now_s = self._strap.crystal.now()
        if measurement is Measurement.PPI:
            first_s = now_s + self._quirks.first_intervals_s
            return _IntervalStream(self._strap, self._data, first_s)
        signal = waveform(
            self._product,
            measurement,
            self._control.running[measurement],
            self._strap.wearer,
            compressed=self._quirks.compressed_acceleration,
        )
        in_sdk_mode = self._control.in_sdk_mode
        true_hz = self._product.true_rate_hz(measurement, signal.rate_hz, sdk_mode=in_sdk_mode)
        rate_hz = true_hz * (1 + self._quirks.sampling_deviation)
        begin_s = now_s + self._quirks.first_sample_s
        return _WaveformStream(self._strap, self._data, signal, rate_hz, begin_s)

    def _choose_pace(self) -> None:
        """Send heart rates as the measurements that run let the device do."""
        if self._control.in_sdk_mode:
            self._strap.pulse_every_s = 0
        else:
            runs_slowly = Measurement.PPI in self._control.running
            self._strap.pulse_every_s = _PULSE_WITH_INTERVALS_S if runs_slowly else 1

    def _end_streams(self) -> None:
        self._choose_pace()
        for measurement in self._streams.keys() - self._control.running.keys():
            stream, task = self._streams.pop(measurement)
            task.cancel()
            stream.end()

    def _lose_host(self) -> None:
        for task in self._answers:
            task.cancel()
        if not self._quirks.keeps_streaming:
            self.forget()
