"""Which advertisements are belts."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.vernier_respiration_belt.driver.driver import identify, recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

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
