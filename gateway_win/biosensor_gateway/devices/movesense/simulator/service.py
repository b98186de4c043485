"""The GATT service of the SensorData Protocol on the air."""

from __future__ import annotations

import asyncio
from functools import partial

from bumble.att import Attribute
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.devices.movesense.simulator import wire
from biosensor_gateway.devices.movesense.simulator.streams import MeasurementStream, stream

_Permissions = Attribute.Permissions
_Properties = Characteristic.Properties


class SensorDataService:
    """Adds the protocol to a strap.

    Parameters
    ----------
    strap
        Gets the service; must not be switched on yet.
    serial
        Of which it tells.
    is_old
        The first version of the firmware: it answers subscriptions only by data, or where it
        has no room for them.
    deviation
        By which share the movement sensor is faster than it should be.

    Attributes
    ----------
    answer_delay_s
        Every command is answered so late.
    refuses
        Every command is refused.
    denied
        Kinds of what there is no room for: ``ecg``, ``hr``, ``temp`` or ``movement``.
    """

    def __init__(self, strap: Strap, serial: str, *, is_old: bool, deviation: float) -> None:
        self.answer_delay_s = 0.0
        self.refuses = False
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
        """End all measurements without a word."""
        for reference in list(self._running):
            self._end(reference)

    def babble(self, packets: float) -> None:
        """Send so many notifications that make no sense."""
        self._strap.run(self._send_garbage(round(packets)))

    async def _send_garbage(self, packets: int) -> None:
        for value in wire.damaged(self._strap.rng, packets):
            await self._strap.peripheral.notify(self._data, value)

    def _hear(self, _connection: Connection, command: bytes) -> None:
        # The notification must come after the response to this write.
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
        """Return the answer, empty if there is none."""
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
            # It has one answer, and that with its bytes turned round.
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
        # At once, so that parts of different packets do not mix on the air.
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
