"""A virtual Movesense sensor on a chest strap."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from types import MappingProxyType
from typing import Protocol, Unpack

import numpy as np
from bumble.att import Attribute
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.services import RR_TICKS_PER_S, Identity
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import EXPECTED as ANY_STRAP
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import (
    STRAP_EFFECTS,
    BeatDetector,
    MeasurementStream,
    Strap,
    StrapDevice,
)
from biosensor_gateway.devices.movesense.simulator import wire
from biosensor_gateway.devices.movesense.simulator.wire import FULL_MTU, Resource
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import Gap, LossTolerance
from biosensor_gateway.simulation.virtual_device import Filled, SpecimenOptions
from biosensor_gateway.simulation.wearer import Floats, Wearer
from biosensor_gateway.simulation.world import World

_PACKETS_PER_SECOND = 13
_OPEN_ELECTRODES_UV = 30.0
_DETECTION_PERIOD_S = 0.25
_TEMPERATURE_PERIOD_S = 1.0
_ABSOLUTE_ZERO_C = -273.15
# The earth's magnetic field in the position on the chest [uT].
_FIELD_UT = np.array([18.0, -2.0, 42.0])


class Pipe(Protocol):
    """Sends the packets of one subscription."""

    async def __call__(self, payload: bytes) -> bool:
        """Send a packet; return False if the host does not get all of it or cannot read it."""
        ...


class SampledStream:
    """Samples at a constant rate: ECG, or vectors measured together.

    Parameters
    ----------
    deviation
        Relative deviation of the true rate from the nominal one.
    """

    def __init__(self, strap: Strap, resource: Resource, send: Pipe, deviation: float) -> None:
        self._strap = strap
        self._oscillator = strap.oscillator
        self._resource = resource
        self._send = send
        self._rate_hz = resource.rate_hz * (1 + deviation)
        self._begin_s = strap.oscillator.now()
        self._next = 0
        is_ecg = resource.kind == "ecg"
        self._names = ("ecg",) if is_ecg else wire.VECTORS[resource.kind]
        self._count = wire.ECG_SAMPLES if is_ecg else resource.rate_hz // _PACKETS_PER_SECOND

    async def run(self) -> None:
        """Measure and send until cancelled."""
        while True:
            await self._oscillator.reach(self._device_s(self._next + self._count - 1))
            first_s = self._device_s(self._next)
            indices = range(self._next, self._next + self._count)
            times = np.array([self._oscillator.true_time(self._device_s(each)) for each in indices])
            payload, values = self._packet(round(1000 * first_s), times)
            sent = await self._send(payload)
            self._next += self._count
            for name, rows in zip(self._names, values, strict=True):
                self._note(name, times, rows, sent=sent)

    def end(self) -> None:
        """Record the unfinished packet."""
        measured = int((self._oscillator.now() - self._begin_s) * self._rate_hz) + 1
        for name in self._names:
            self._strap.truth.unsent(name, max(0, measured - self._next))

    def _packet(self, stamp_ms: int, times: Floats) -> tuple[bytes, list[Floats]]:
        """Return the bytes, and the samples in declared units."""
        t = times - self._strap.origin_s
        wearer, worn = self._strap.wearer, self._strap.worn
        if self._resource.kind == "ecg":
            open_circuit = wearer.noise(t, _OPEN_ELECTRODES_UV, "electrodes")
            microvolts = wearer.ecg_uv(t) if worn else open_circuit
            payload, held = wire.ecg(stamp_ms, microvolts, scaled=self._resource.scaled)
            return payload, [held[:, np.newaxis]]
        units = {"acc": wire.GRAVITY, "gyro": 1.0, "mag": 1.0}
        measured = [_vectors(wearer, name, t) * units[name] for name in self._names]
        payload, arrays = wire.vectors(stamp_ms, measured)
        return payload, [
            array / units[name] for name, array in zip(self._names, arrays, strict=True)
        ]

    def _note(self, name: str, times: Floats, rows: Floats, *, sent: bool) -> None:
        if sent:
            self._strap.truth.sent(name, times.tolist(), rows.tolist())
        elif self._strap.peripheral.connected:
            self._strap.truth.unsent(name, len(times))

    def _device_s(self, index: int) -> float:
        return self._begin_s + index / self._rate_hz


class HeartRateStream:
    """Mean heart rate and R-R interval, sent with each beat without a timestamp."""

    def __init__(self, strap: Strap, send: Pipe) -> None:
        self._strap = strap
        self._send = send
        now_s = strap.oscillator.clock()
        self._detector = BeatDetector(strap.wearer, strap.oscillator, strap.origin_s, now_s)

    async def run(self) -> None:
        """Detect and send beats until cancelled."""
        oscillator = self._strap.oscillator
        device_s = oscillator.now()
        while True:
            device_s += _DETECTION_PERIOD_S
            until_s = await oscillator.reach(device_s)
            if not self._strap.worn:
                self._detector.lose(until_s)
                continue
            for interval in self._detector.search(until_s):
                length_ms = round(1000 * interval.rr / RR_TICKS_PER_S)
                bpm = float(self._detector.bpm)
                if await self._send(wire.heart_rate(bpm, length_ms)):
                    self._strap.truth.sent("hr", [until_s], [(bpm,)])
                    self._strap.truth.sent("ibi", [interval.time], [(length_ms / 1000,)])

    def end(self) -> None:
        """Do nothing: the next subscription sends the next beat."""


class TemperatureStream:
    """Temperature of the device, once a second."""

    def __init__(self, strap: Strap, send: Pipe) -> None:
        self._strap = strap
        self._send = send

    async def run(self) -> None:
        """Measure and send until cancelled."""
        oscillator = self._strap.oscillator
        device_s = oscillator.now()
        while True:
            device_s += _TEMPERATURE_PERIOD_S
            measured_s = await oscillator.reach(device_s)
            t = np.array([measured_s - self._strap.origin_s])
            celsius = self._strap.wearer.skin_temperature_c(t)[0]
            kelvin = np.float32(celsius - _ABSOLUTE_ZERO_C)
            if await self._send(wire.temperature(round(1000 * device_s), float(kelvin))):
                held = float(kelvin) + _ABSOLUTE_ZERO_C
                self._strap.truth.sent("temp", [measured_s], [(held,)])

    def end(self) -> None:
        """Do nothing: an irregular stream has no missing samples."""


def stream(strap: Strap, resource: Resource, send: Pipe, deviation: float) -> MeasurementStream:
    """Return the measurement of a resource."""
    match resource.kind:
        case "hr":
            return HeartRateStream(strap, send)
        case "temp":
            return TemperatureStream(strap, send)
        case "ecg":
            return SampledStream(strap, resource, send, 0.0)
        case _:
            # The movement sensor has its own oscillator.
            return SampledStream(strap, resource, send, deviation)


def _vectors(wearer: Wearer, name: str, t: Floats) -> Floats:
    if name == "acc":
        return wearer.acceleration_g(t)
    axes = [wearer.noise(t, 0.5, f"{name}{axis}") for axis in "xyz"]
    return np.stack(axes, axis=1) + (_FIELD_UT if name == "mag" else 0.0)


# The heart rate service, and the UUID assigned to the vendor.
_ADVERTISED = ("180d", "fdf3")
# Measurements that are denied, one at a time.
_DENIABLE = ("hr", "temp", "ecg", "movement")

EXPECTED = replace(
    ANY_STRAP,
    impossible={
        FaultKind.REPEAT: "each interval comes in its own message",
        Untidiness.RATE: "the subscription's path contains the rate",
        Untidiness.STRAY: "a message of another subscription counts as garbage",
    },
    # The device is off during the gap.
    gaps={FaultKind.RESTART: Gap.STOPPED},
    # Each connection starts a new series, whose start is only known by time.
    loss_tolerance=LossTolerance(over_break=2),
)

_Permissions = Attribute.Permissions
_Properties = Characteristic.Properties


class _SensorDataService:
    """Adds the service of the protocol to a strap.

    Parameters
    ----------
    strap
        Gets the service; must be off.
    serial
        Serial number that it reports.
    is_old
        Simulate first-version firmware, which answers subscriptions only with data, or if it has
        no free slot.
    deviation
        Relative deviation of the movement sensor's rate.
    """

    def __init__(self, strap: Strap, serial: str, *, is_old: bool, deviation: float) -> None:
        self.answer_delay_s = 0.0
        self.refuses = False  # Whether every command is refused.
        # Kinds of measurements without a free slot: `ecg`, `hr`, `temp` or `movement`.
        self.denied: frozenset[str] = frozenset()
        self._strap = strap
        self._serial = serial
        self._is_old = is_old
        self._deviation = deviation
        self._conversation = asyncio.Lock()
        self._answers: set[asyncio.Task[None]] = set()
        self._running: dict[int, tuple[MeasurementStream, asyncio.Task[None]]] = {}
        commands = Characteristic[bytes](
            wire.COMMAND_UUID,
            _Properties.WRITE,
            _Permissions.WRITEABLE | _Permissions.WRITE_REQUIRES_AUTHENTICATION,
            CharacteristicValue(write=self._hear),
        )
        self._data = Characteristic[bytes](
            wire.DATA_UUID, _Properties.NOTIFY, _Permissions.READABLE, b""
        )
        strap.services.append(Service(wire.SERVICE_UUID, [commands, self._data]))
        strap.on_power_off.append(self.forget)
        strap.peripheral.on_disconnected.append(self._lose_host)

    def forget(self) -> None:
        """End all measurements silently."""
        for reference in list(self._running):
            self._end(reference)

    def babble(self, packets: float) -> None:
        """Send invalid notifications."""
        self._strap.run(self._send_garbage(round(packets)))

    async def _send_garbage(self, packets: int) -> None:
        for value in wire.damaged(self._strap.rng, packets):
            await self._strap.peripheral.notify(self._data, value)

    def _hear(self, _connection: Connection, command: bytes) -> None:
        # The notification must follow the response to this write.
        task = self._strap.run(self._answer(command))
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def _answer(self, command: bytes) -> None:
        async with self._conversation:
            await asyncio.sleep(self.answer_delay_s)
            answer = self._carry_out(command) if len(command) > 1 else b""
            if answer:
                room = self._strap.peripheral.host_mtu - wire.ATT_HEADER_BYTES
                await self._strap.peripheral.notify(self._data, answer[:room])

    def _carry_out(self, command: bytes) -> bytes:
        """Execute a command; return the answer, empty if there is none."""
        code, reference, argument = command[0], command[1], command[2:]
        if self.refuses:
            return wire.status(reference, wire.FORBIDDEN)
        match code:
            case wire.HELLO:
                return wire.greeting(reference, self._serial, old=self._is_old)
            case wire.SUBSCRIBE:
                result = self._subscribe(reference, argument)
            case wire.UNSUBSCRIBE:
                result = wire.OK if reference in self._running else wire.NOT_FOUND
                self._end(reference)
            case _:
                result = wire.BAD_REQUEST
        if self._is_old:
            # The old firmware has only this answer, with swapped bytes.
            return bytes((wire.ANSWER, reference, 0x01, 0xFB)) if result == wire.NO_SLOT else b""
        return wire.status(reference, result)

    def _subscribe(self, reference: int, path: bytes) -> int:
        if len(self._running) >= wire.SLOTS and reference not in self._running:
            return wire.NO_SLOT
        resource = wire.resource(path)
        if resource is None:
            return wire.NOT_FOUND
        if ("movement" if resource.kind in wire.VECTORS else resource.kind) in self.denied:
            return wire.NO_SLOT
        self._end(reference)
        measured = stream(self._strap, resource, partial(self._send, reference), self._deviation)
        self._running[reference] = measured, self._strap.run(measured.run())
        return wire.OK

    async def _send(self, reference: int, payload: bytes) -> bool:
        is_readable = not self._strap.is_unreadable
        cut = payload if is_readable else payload[:-1]
        first, *others = wire.parts(reference, cut, self._strap.peripheral.host_mtu)
        sent = await self._strap.send(self._data, first)
        # Without a pause, so that parts of different packets are not mixed.
        for part in others:
            sent = await self._strap.peripheral.notify(self._data, part) and sent
        return sent and is_readable

    def _end(self, reference: int) -> None:
        measured, task = self._running.pop(reference, (None, None))
        if measured is not None and task is not None:
            task.cancel()
            measured.end()

    def _lose_host(self) -> None:
        for task in self._answers:
            task.cancel()
        self.forget()


@dataclass(frozen=True)
class Firmware:
    """A firmware version."""

    is_old: bool = False  # Whether it uses the first version of the protocol.
    max_mtu: int = FULL_MTU  # Largest ATT MTU that it accepts.
    demands_pairing: bool = False  # Whether it accepts commands only from a paired host.


class SimulatedMovesense(StrapDevice):
    """A sensor with the services of a strap and the GATT SensorData Protocol.

    Parameters
    ----------
    serial
        Twelve digits, as engraved.
    firmware
        Its firmware; a new version by default.
    deviation
        Relative deviation of the movement sensor's rate.
    rssi_dbm
        Signal strength as received.
    """

    sensor = "movesense"
    each_own = MappingProxyType(
        {"address": "0C:8C:DC:10:F8:{number:02X}", "serial": "1746300002{number:02d}"}
    )
    expected = EXPECTED
    on_air = True
    filled = MappingProxyType({"mag": Filled(None, "it is switched off unless the settings ask")})

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "0C:8C:DC:10:F7:D3",
        serial: str = "174630000192",
        firmware: Firmware | None = None,
        deviation: float = 0.02,
        rssi_dbm: int = -60,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self.device = serial
        self._to_deny = cycle(_DENIABLE)
        firmware = firmware or Firmware()
        peripheral = Peripheral(
            radio,
            address,
            f"Movesense {serial}",
            service_uuids=_ADVERTISED,
            rssi_dbm=rssi_dbm,
            max_mtu=firmware.max_mtu,
        )
        peripheral.demand_pairing = firmware.demands_pairing
        self._strap = Strap(
            peripheral,
            self.truth,
            self.specimen,
            identity=Identity("Movesense", "Movesense HR2", serial, firmware="2.3.1"),
            tells_contact=False,
        )
        self._service = _SensorDataService(
            self._strap, serial, is_old=firmware.is_old, deviation=deviation
        )

    def _break_link(self) -> None:
        self._strap.break_link()

    def _babble(self, packets: float) -> None:
        self._service.babble(packets)

    def _forget(self, _: float) -> None:
        self._service.forget()

    def _deny(self) -> None:
        self._break_link()
        self._service.denied = frozenset({next(self._to_deny)})

    def _allow(self) -> None:
        self._service.denied = frozenset()

    effects = MappingProxyType(
        {
            **on_part("_strap", STRAP_EFFECTS),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: flag("_service.refuses", then=_break_link),
            FaultKind.DENY: lasting(_deny, _allow),
            FaultKind.LATE: level("_service.answer_delay_s", 0.0, then=_break_link),
        }
    )
