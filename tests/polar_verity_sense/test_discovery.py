"""Which advertisements are Polar's optical sensors, and the settings they make."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.polar_verity_sense.driver import (
    PolarVeritySenseSettings,
    identify,
    recognise,
)
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})


def seen(name: str) -> Advertisement:
    return Advertisement("A0:9E:1A:00:00:01", name, -58, HEART_RATE)


@pytest.mark.parametrize("model", ["Sense", "Verity Sense", "OH1", "360"])
def test_each_product_is_found_by_its_name(model: str) -> None:
    found = recognise(seen(f"Polar {model} A1B2C3D4"))
    assert found is not None
    assert (found.sensor, found.rssi_dbm) == ("polar_verity_sense", -58)
    assert found.name == f"Polar {model} A1B2C3D4"
    settings = PolarVeritySenseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("A1B2C3D4", "A0:9E:1A:00:00:01")


@pytest.mark.parametrize("name", ["", "Polar", "Polar H10 A1B2C3D4", "Polar 360", "Sense A1B2C3D4"])
def test_other_names_are_other_devices(name: str) -> None:
    assert identify(seen(name)) is None
    assert recognise(seen(name)) is None


def test_a_serial_port_is_none() -> None:
    assert recognise(SerialPort("COM7", "Polar Sense A1B2C3D4")) is None
