"""Which advertisements are belts."""

from __future__ import annotations

import pytest

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.vernier_respiration_belt.driver import (
    DRIVER,
    identify,
    protocol,
    recognise,
)
from biosensor_gateway.devices.vernier_respiration_belt.simulator import wire
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from biosensor_gateway.transports.tap import What

ADDRESS = "E0:F5:BD:94:6A:1B"


def test_a_belt_is_found_with_its_serial_number_and_its_address() -> None:
    found = recognise(Advertisement(ADDRESS, "GDX-RB 0K2002Z5", -61))
    settings = {"unit": "0K2002Z5", "device": ADDRESS}
    assert found == Found("vernier_respiration_belt", "GDX-RB 0K2002Z5", settings, -61)


def test_a_belt_without_a_serial_number_is_known_by_its_address() -> None:
    found = recognise(Advertisement(ADDRESS, "GDX-RB"))
    assert found is not None
    assert found.settings == {"unit": ADDRESS, "device": ADDRESS}


@pytest.mark.parametrize("name", ["", "GDX-HD 0K2002Z5", "GDX-RBX 0K2002Z5", "gdx"])
def test_other_devices_are_none(name: str) -> None:
    assert identify(Advertisement(ADDRESS, name)) is None
    assert recognise(Advertisement(ADDRESS, name)) is None


def test_serial_ports_are_none() -> None:
    assert recognise(SerialPort("COM7", "GDX-RB 0K2002Z5")) is None


SERIAL = "0K2002Z5"
ADDRESS_AT, ADDRESS_BYTES = 78, 6


def test_the_address_is_replaced_and_the_rest_is_read_alike() -> None:
    info = wire.device_info("GDX-RB", SERIAL)
    address = slice(ADDRESS_AT, ADDRESS_AT + ADDRESS_BYTES)
    assert any(info[address])
    # In packets of 20 bytes, as over a small MTU.
    events = [
        Event(t=0.0, link=0, what=What.CAME, data=info[at : at + 20].hex())
        for at in range(0, len(info), 20)
    ]
    told = Redaction(lambda _: False, DRIVER.identifiers).of(events, [SERIAL])
    joined = b"".join(each.bytes for each in told)
    assert joined[address] != info[address]
    assert SERIAL.encode() not in joined
    assert sum(joined) % 256 == sum(info) % 256
    before, after = protocol.parse_device_info(info), protocol.parse_device_info(joined)
    assert before is not None
    assert after is not None
    assert (after.order_code, after.firmware) == (before.order_code, before.firmware)
