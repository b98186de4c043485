"""Which advertisements are Movesense sensors, and how they come into the settings."""

from __future__ import annotations

import pytest

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.movesense.driver import (
    DRIVER,
    MovesenseSettings,
    identify,
    recognise,
)
from biosensor_gateway.devices.movesense.driver.protocol import parse_greeting, parse_message
from biosensor_gateway.devices.movesense.simulator import wire
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from biosensor_gateway.transports.tap import What

ADDRESS = "0C:8C:DC:10:F7:D3"
HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})


def seen(name: str) -> Advertisement:
    return Advertisement(ADDRESS, name, -60, HEART_RATE)


def test_a_sensor_is_found_with_the_settings_that_lead_to_it() -> None:
    found = recognised(drivers_by_precedence(), seen("Movesense 174630000192"))
    assert found is not None
    assert (found.sensor, found.name) == ("movesense", "Movesense 174630000192")
    settings = MovesenseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("174630000192", ADDRESS)
    assert identify(seen("Movesense 174630000192")) == "174630000192"


@pytest.mark.parametrize("name", ["", "Movesensex 1", "Polar H10 A1B2C3D4", "My Movesense 1"])
def test_anything_else_is_none(name: str) -> None:
    assert recognise(seen(name)) is None


def test_a_serial_port_is_none() -> None:
    assert recognise(SerialPort("COM7", "Movesense 174630000192")) is None


SERIAL = "174630000192"


def test_address_and_serial_number_are_replaced_and_the_rest_is_read_alike() -> None:
    data = wire.greeting(3, SERIAL, old=False)
    event = Event(t=0.0, link=0, what=What.CAME, data=data.hex())
    (told,) = Redaction(lambda _: False, DRIVER.identifiers).of([event], [SERIAL])
    assert b"0C8CDC000001" not in told.bytes
    assert SERIAL.encode() not in told.bytes
    message = parse_message(told.bytes)
    assert message is not None
    greeting = parse_greeting(message.payload)
    assert greeting.product == "Movesense HR2"
    assert len(greeting.serial_number) == len(SERIAL)
