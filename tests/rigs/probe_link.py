"""The agent's Bluetooth LE link to the made-up device of `tests.rigs.probe`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

import pytest

from biosensor_common.errors import GatewayError
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.nearby import Advertisement
from tests.rigs.probe import Probe

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
