"""A belt's address stands in what it says of itself, which macOS does not tell otherwise."""

from __future__ import annotations

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.vernier_respiration_belt.driver import protocol
from biosensor_gateway.devices.vernier_respiration_belt.driver.driver import DRIVER
from biosensor_gateway.devices.vernier_respiration_belt.simulator import wire
from biosensor_gateway.transports.tap import What

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
