"""The PMD service on the air: control point, data, and the measurements that run."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from bumble.att import ATT_Error, Attribute, ErrorCode
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.devices.polar_h10.simulator import frames, pmd
from biosensor_gateway.devices.polar_h10.simulator.control_point import ControlPoint
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Product
from biosensor_gateway.devices.polar_h10.simulator.quirks import Quirks
from biosensor_gateway.devices.polar_h10.simulator.streams import (
    IntervalStream,
    MeasurementStream,
    WaveformStream,
)
from biosensor_gateway.devices.polar_h10.simulator.waveforms import waveform

_Permissions = Attribute.Permissions
_Properties = Characteristic.Properties
_PULSE_WITH_INTERVALS_S = 5


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
        """Stop measurements on the device's own account and say so."""
        packet = self._control.stop(measurements)
        self._end_streams()
        await self._strap.peripheral.notify(self._control_point, packet)

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

    def _stream(self, measurement: Measurement) -> MeasurementStream:
        now_s = self._strap.crystal.now()
        if measurement is Measurement.PPI:
            first_s = now_s + self._quirks.first_intervals_s
            return IntervalStream(self._strap, self._data, first_s)
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
        return WaveformStream(self._strap, self._data, signal, rate_hz, begin_s)

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
