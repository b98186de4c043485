"""A made-up Bluetooth LE device that has one characteristic, and the agent's link to it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

import pytest
from bumble.att import ATT_Error, Attribute
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_common.errors import GatewayError
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import MAX_MTU, Radio
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.nearby import Advertisement

# A made-up Bluetooth LE device that has one characteristic of every kind.

_P = Characteristic.Properties
_A = Attribute.Permissions
SERVICE = "12340000-1111-2222-3333-444455556666"
SERIAL = "12340001-1111-2222-3333-444455556666"
NOTE = "12340002-1111-2222-3333-444455556666"
FLOW = "12340003-1111-2222-3333-444455556666"
EVENT = "12340004-1111-2222-3333-444455556666"
SECRET = "12340005-1111-2222-3333-444455556666"
REFUSAL = "12340006-1111-2222-3333-444455556666"
COMPANY = 0x0B0B


class Probe:
    """The device; a test steers it through the world of its radio."""

    def __init__(
        self, radio: Radio, address: str, name: str, *, rssi_dbm: int = -58, max_mtu: int = MAX_MTU
    ) -> None:
        self.radio = radio
        self.peripheral = Peripheral(
            radio,
            address,
            name,
            service_uuids=["180d", "feee"],
            manufacturer_data={COMPANY: b"\x01\x02\x03"},
            rssi_dbm=rssi_dbm,
            max_mtu=max_mtu,
        )
        self.notes: list[bytes] = []  # What was written to `NOTE`.
        # Notifies.
        self.flow = Characteristic[bytes](FLOW, _P.NOTIFY | _P.READ, _A.READABLE, b"still")
        self.event = Characteristic[bytes](EVENT, _P.INDICATE, _A.READABLE)  # Indicates.

    @property
    def address(self) -> str:
        """Its Bluetooth address."""
        return self.peripheral.address

    def power_on(self) -> None:
        """Switch on."""
        self.radio.world.await_(self.peripheral.power_on([self._service()]))

    def power_off(self) -> None:
        """Switch off."""
        self.radio.world.await_(self.peripheral.power_off())

    def drop(self) -> None:
        """Lose the link."""
        self.radio.world.call(self.peripheral.drop)

    def restore(self) -> None:
        """Come back."""
        self.radio.world.call(self.peripheral.restore)

    def set_stalled(self, stalled: bool) -> None:
        """Hang, or go on."""
        self.radio.world.call(lambda: setattr(self.peripheral, "stalled", stalled))

    def notify(self, characteristic: Characteristic[bytes], *values: bytes) -> list[bool]:
        """Send values one after another; which were sent."""

        async def send() -> list[bool]:
            return [await self.peripheral.notify(characteristic, value) for value in values]

        return self.radio.world.await_(send())

    def begin_notify(
        self, characteristic: Characteristic[bytes], value: bytes
    ) -> asyncio.Future[bool]:
        """Send a value without waiting, which an indication may have to do for long."""
        sending = self.peripheral.notify(characteristic, value)
        loop = self.radio.world.loop
        return asyncio.wrap_future(asyncio.run_coroutine_threadsafe(sending, loop))

    def _service(self) -> Service:
        note = CharacteristicValue[bytes](
            read=lambda _: self.notes[-1] if self.notes else b"", write=self._write_note
        )
        refusal = CharacteristicValue[bytes](read=_refuse_reading, write=_refuse_writing)
        writes = _P.READ | _P.WRITE | _P.WRITE_WITHOUT_RESPONSE
        open_to_all = _A.READABLE | _A.WRITEABLE
        guarded = _A.READ_REQUIRES_AUTHENTICATION | _A.WRITE_REQUIRES_AUTHENTICATION
        return Service(
            SERVICE,
            [
                Characteristic[bytes](SERIAL, _P.READ, _A.READABLE, b"0815"),
                Characteristic[bytes](NOTE, writes, open_to_all, note),
                self.flow,
                self.event,
                Characteristic[bytes](SECRET, writes | _P.NOTIFY, guarded, b"secret"),
                Characteristic[bytes](REFUSAL, writes, open_to_all, refusal),
            ],
        )

    async def _write_note(self, _connection: Connection, value: bytes) -> None:
        await asyncio.sleep(0)
        self.notes.append(value)


def _refuse_reading(_connection: Connection) -> bytes:
    raise ATT_Error(0x80)


def _refuse_writing(_connection: Connection, value: bytes) -> None:
    raise ATT_Error(value[0])


# The agent's Bluetooth LE link to the made-up device of `tests.rigs.probe`.
DEADLINE_S = 20.0


def switched_on(radio: Radio, number: int, name: str = "", *, rssi_dbm: int = -58) -> Probe:
    """Switch on one of several probes, by default called by its number."""
    address = f"A0:9E:1A:00:00:{number:02X}"
    probe = Probe(radio, address, name or f"Probe {number}", rssi_dbm=rssi_dbm)
    probe.power_on()
    return probe


def choice(device: str = "") -> Choice:
    """Choose a probe by its number."""
    return Choice(_number_of, "Probe", device, "press its button")


def generic_choice(device: str = "") -> Choice:
    """Choose any device, as one of a kind that has others in it."""
    return Choice(lambda seen: seen.address, "thing", device, "press its button", is_generic=True)


async def refusal(attempt: Awaitable[object]) -> GatewayError:
    """Return the error that something ends with, and it must."""
    with pytest.raises(GatewayError) as caught:
        await asyncio.wait_for(attempt, DEADLINE_S)
    return caught.value


def _number_of(seen: Advertisement) -> str | None:
    kind, _, number = seen.name.partition(" ")
    return number if kind == "Probe" else None
