"""The PMD service of a virtual device: control point, data, and running measurements."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from itertools import cycle

import numpy as np
from bumble.att import ATT_Error, Attribute, ErrorCode
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.services import RR_TICKS_PER_S
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import (
    BeatDetector,
    MeasurementStream,
    Strap,
)
from biosensor_gateway.devices.polar_h10.simulator import pmd
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ATT_HEADER_BYTES,
    FULL_MTU,
    Integers,
    Measurement,
    Offered,
    OpCode,
    PulseInterval,
    Setting,
    Status,
    decode_choice,
    encode_settings,
)
from biosensor_gateway.devices.polar_h10.simulator.products import (
    Product,
    Quirks,
    Waveform,
    waveform,
)

_REPLY = 0xF0
_STOPPED_BY_DEVICE = 0x01
_REPLY_HEADER_BYTES = 5
# Flag of a running measurement in the reply to `OpCode.GET_STATUS`.
_ONLINE = 0x40
_INVALID = {
    Setting.SAMPLE_RATE: Status.INVALID_SAMPLE_RATE,
    Setting.RESOLUTION: Status.INVALID_RESOLUTION,
    Setting.RANGE: Status.INVALID_RANGE,
    Setting.CHANNELS: Status.INVALID_NUMBER_OF_CHANNELS,
}


class _Refusal(Exception):  # noqa: N818 - a course of the conversation, not an error
    """A command fails with a status."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


class ControlPoint:
    """One device's measurements, and the commands that start and stop them.

    Parameters
    ----------
    running
        Measurements that a previous host left running, with the first available settings.
    minimum_mtu
        Starts with a smaller ATT MTU are refused with INVALID_MTU.
    short_errors
        Whether error replies end after the status, as in some firmware.
    announces_stops
        Whether a stop on command is followed by the notice of a stop by the device.
    """

    def __init__(
        self,
        product: Product,
        *,
        running: Iterable[Measurement] = (),
        minimum_mtu: int = 0,
        short_errors: bool = False,
        announces_stops: bool = False,
    ) -> None:
        self.running = {measurement: _first_choice(product, measurement) for measurement in running}
        self.refuses = False  # Whether every command fails with INVALID_STATE.
        # Measurements for which every start fails with INVALID_STATE.
        self.denied: frozenset[Measurement] = frozenset()
        self._product = product
        self._minimum_mtu = max(minimum_mtu, product.minimum_mtu)
        self._short_errors = short_errors
        self._announces_stops = announces_stops

    @property
    def in_sdk_mode(self) -> bool:
        """Whether SDK mode is on, with more settings but without evaluation in the device."""
        return Measurement.SDK_MODE in self.running

    def answer(self, command: bytes, mtu: int) -> tuple[bytes, ...]:
        """Execute or refuse one command received over a link with this ATT MTU.

        Returns
        -------
        tuple of bytes
            Indications to send, in order.
        """
        head = bytes((_REPLY,)) + command[:2].ljust(2, b"\0")
        try:
            return self._obey(head, command[1:], mtu)
        except _Refusal as refusal:
            reply = head + bytes((refusal.status, 0))
            return (reply[:-1] if self._short_errors else reply,)

    def stop(self, measurements: Iterable[Measurement]) -> bytes:
        """Stop measurements as the device itself; return the notice packet."""
        stopped = [one for one in measurements if self.running.pop(one, None) is not None]
        return bytes((_STOPPED_BY_DEVICE, *stopped))

    def _obey(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        if self.refuses:
            raise _Refusal(Status.INVALID_STATE)
        match head[1]:
            case OpCode.GET_SETTINGS:
                return _reply(head, self._settings(body, sdk_mode=self.in_sdk_mode), mtu)
            case OpCode.START:
                return self._start(head, body, mtu)
            case OpCode.STOP:
                return self._stop(head, body, mtu)
            case OpCode.GET_STATUS:
                states = (one | _ONLINE * (one in self.running) for one in self._product.settings)
                return _reply(head, bytes(states), mtu)
            case OpCode.GET_SDK_SETTINGS if self._product.sdk_settings:
                return _reply(head, self._settings(body, sdk_mode=True), mtu)
            case OpCode.GET_SDK_STATUS if self._product.sdk_settings:
                return _reply(head, bytes((self.in_sdk_mode,)), mtu)
            case OpCode.GET_SDK_SETTINGS | OpCode.GET_SDK_STATUS:
                raise _Refusal(Status.NOT_SUPPORTED)
            case _:
                raise _Refusal(Status.INVALID_OP_CODE)

    def _settings(self, body: bytes, *, sdk_mode: bool) -> bytes:
        measurement = self._measurement(body)
        if len(body) != 1:
            raise _Refusal(Status.INVALID_LENGTH)
        offered = self._product.offered(sdk_mode=sdk_mode)
        if measurement not in offered:
            raise _Refusal(Status.NOT_SUPPORTED)
        return encode_settings(offered[measurement])

    def _start(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        measurement = self._measurement(body)
        if measurement in self.running:
            raise _Refusal(Status.ALREADY_IN_STATE)
        if measurement in self.denied:
            raise _Refusal(Status.INVALID_STATE)
        if measurement is Measurement.SDK_MODE and self.running:
            raise _Refusal(Status.INVALID_STATE)
        offered = self._product.offered(sdk_mode=self.in_sdk_mode).get(measurement)
        if offered is None and measurement is not Measurement.SDK_MODE:
            raise _Refusal(Status.NOT_SUPPORTED)
        if mtu < self._minimum_mtu:
            raise _Refusal(Status.INVALID_MTU)
        chosen = _choice(offered or {}, body[1:])
        self.running[measurement] = chosen
        return _reply(head, self._product.start_reply(measurement, chosen), mtu)

    def _stop(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        measurement = self._measurement(body)
        if len(body) != 1:
            raise _Refusal(Status.INVALID_LENGTH)
        if measurement not in self.running:
            raise _Refusal(Status.ALREADY_IN_STATE)
        if measurement is Measurement.SDK_MODE and len(self.running) > 1:
            raise _Refusal(Status.INVALID_STATE)
        announcement = self.stop((measurement,))
        reply = _reply(head, b"", mtu)
        return (*reply, announcement) if self._announces_stops else reply

    def _measurement(self, body: bytes) -> Measurement:
        if not body:
            raise _Refusal(Status.INVALID_LENGTH)
        try:
            measurement = Measurement(body[0])
        except ValueError:
            raise _Refusal(Status.INVALID_MEASUREMENT_TYPE) from None
        if measurement not in self._product.features:
            raise _Refusal(Status.NOT_SUPPORTED)
        return measurement


def _choice(offered: Offered, data: bytes) -> dict[Setting, int]:
    try:
        chosen = decode_choice(data)
    except EOFError:
        raise _Refusal(Status.INVALID_LENGTH) from None
    except ValueError:
        raise _Refusal(Status.INVALID_PARAMETER) from None
    if chosen.keys() != offered.keys():
        raise _Refusal(Status.INVALID_PARAMETER)
    for setting, value in chosen.items():
        if value not in offered[setting]:
            raise _Refusal(_INVALID.get(setting, Status.INVALID_PARAMETER))
    return chosen


def _first_choice(product: Product, measurement: Measurement) -> dict[Setting, int]:
    offered = product.settings.get(measurement, {})
    return {setting: values[0] for setting, values in offered.items()}


def _reply(head: bytes, parameters: bytes, mtu: int) -> tuple[bytes, ...]:
    room = mtu - ATT_HEADER_BYTES - _REPLY_HEADER_BYTES
    parts = [parameters[at : at + room] for at in range(0, len(parameters), room)] or [b""]
    return tuple(
        head + bytes((Status.SUCCESS, number < len(parts))) + part
        for number, part in enumerate(parts, start=1)
    )


_Permissions = Attribute.Permissions
_Properties = Characteristic.Properties
_PULSE_WITH_INTERVALS_S = 5

POWER_ON_NS = 599_616_000_000_000_000
"""Device clock at power-on, in ns since 2000: the year 2019."""
_INTERVAL_PERIOD_S = 5
_INTERVAL_BYTES = 6
_INTERVAL_ERROR_MS = 8


class _WaveformStream:
    """Samples at a constant rate.

    Parameters
    ----------
    waveform
        The measured signal.
    rate_hz
        The true rate in device time.
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
        self._oscillator = strap.oscillator
        self._data = data
        self._waveform = waveform
        self._rate_hz = rate_hz
        self._begin_s = begin_s
        self._next = 0

    async def run(self) -> None:
        """Measure and send until cancelled."""
        while True:
            count = self._waveform.planned(_room(self._strap))
            await self._oscillator.reach(self._device_s(self._next + count - 1))
            await self._send(count)

    def end(self) -> None:
        """Record the unfinished frame."""
        measured = int((self._oscillator.now() - self._begin_s) * self._rate_hz) + 1
        self._strap.truth.unsent(self._waveform.data_name, max(0, measured - self._next))

    async def _send(self, count: int) -> None:
        indices = np.arange(self._next, self._next + count)
        begin_s, end_s = (
            self._oscillator.true_time(self._device_s(int(i))) for i in indices[[0, -1]]
        )
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
    """Pulse-to-pulse intervals with their errors, sent every five seconds without timestamps.

    Parameters
    ----------
    first_s
        Device time of the first intervals [s since power-on].
    """

    def __init__(self, strap: Strap, data: Characteristic[bytes], first_s: float) -> None:
        self._strap = strap
        self._data = data
        self._next_s = first_s
        now_s = strap.oscillator.clock()
        self._detector = BeatDetector(strap.wearer, strap.oscillator, strap.origin_s, now_s)

    async def run(self) -> None:
        """Measure and send until cancelled."""
        while True:
            await self._send(await self._strap.oscillator.reach(self._next_s))
            self._next_s += _INTERVAL_PERIOD_S

    def end(self) -> None:
        """Do nothing: later intervals were not evaluated yet, so none is missing."""

    async def _send(self, until_s: float) -> None:
        if not self._strap.worn:
            self._detector.lose(until_s)
            return
        self._detector.begin_at(self._strap.put_on_s)
        intervals = self._detector.search(until_s)
        lengths_ms = [round(1000 * one.rr / RR_TICKS_PER_S) for one in intervals]
        per_frame = (_room(self._strap) - pmd.HEADER_BYTES) // _INTERVAL_BYTES
        for at in range(0, len(intervals), per_frame):
            part = slice(at, at + per_frame)
            entries = [
                PulseInterval(self._detector.bpm, length, _INTERVAL_ERROR_MS)
                for length in lengths_ms[part]
            ]
            if await _send(self._strap, self._data, pmd.pulse_intervals(0, entries)):
                times = [one.time for one in intervals[part]]
                values = [(each / 1000, _INTERVAL_ERROR_MS / 1000) for each in lengths_ms[part]]
                self._strap.truth.sent("ppi", times, values)


async def _send(strap: Strap, data: Characteristic[bytes], frame: bytes) -> bool:
    """Send a frame; return False if the host cannot receive or read it."""
    if strap.is_unreadable:
        await strap.send(data, pmd.in_unknown_format(frame))
        return False
    return await strap.send(data, frame)


def _room(strap: Strap) -> int:
    return min(strap.peripheral.host_mtu, FULL_MTU) - ATT_HEADER_BYTES


class PmdService:
    """Adds the PMD service to a strap.

    Parameters
    ----------
    strap
        Gets the service; must be off.
    product, quirks
        Determine the measurements and their behaviour.
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
        self._streams: dict[Measurement, tuple[MeasurementStream, asyncio.Task[None]]] = {}
        self._control_point = self._describe_control_point()
        self._data = Characteristic[bytes](
            pmd.DATA_UUID, _Properties.NOTIFY, _Permissions.READABLE, b""
        )
        strap.services.append(Service(pmd.SERVICE_UUID, [self._control_point, self._data]))
        strap.on_power_on.append(self._begin_streams)
        strap.on_power_off.append(self.forget)
        strap.peripheral.on_disconnected.append(self._lose_host)

    async def stop(self, measurements: Iterable[Measurement]) -> None:
        """Stop measurements as the device itself, and send the notice."""
        packet = self._control.stop(measurements)
        self._end_streams()
        await self._strap.peripheral.notify(self._control_point, packet)

    def deny(self) -> None:
        """Refuse one of its measurements, a different one each time."""
        self._control.denied = frozenset({next(self._to_deny)})

    def give(self) -> None:
        """Stop refusing measurements."""
        self._control.denied = frozenset()

    @property
    def refuses(self) -> bool:
        """Whether every command is refused."""
        return self._control.refuses

    @refuses.setter
    def refuses(self, refuses: bool) -> None:
        self._control.refuses = refuses

    def babble(self, packets: float) -> None:
        """Send damaged PMD frames."""
        self._strap.run(self._send_garbage(round(packets)))

    def forget(self) -> None:
        """Stop all measurements silently."""
        self._control.running.clear()
        self._end_streams()

    async def _send_garbage(self, packets: int) -> None:
        for frame in pmd.damaged(self._strap.rng, packets):
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
        # The indication must follow the response to this write.
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

    def _stream(self, measurement: Measurement) -> MeasurementStream:
        now_s = self._strap.oscillator.now()
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
        return _WaveformStream(self._strap, self._data, signal, true_hz, now_s)

    def _choose_pace(self) -> None:
        """Set the heart rate interval according to the running measurements."""
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
