"""A sensor's address stands in its greeting, which a computer may not have been told otherwise."""

from __future__ import annotations

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.movesense.driver.driver import DRIVER
from biosensor_gateway.devices.movesense.driver.protocol import parse_greeting, parse_message
from biosensor_gateway.devices.movesense.simulator import wire
from biosensor_gateway.transports.tap import What

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
