"""Which serial ports are a Shimmer's, and which sensor gets them."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.registry import sensor
from biosensor_gateway.devices.shimmer.driver.driver import recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort


@pytest.mark.parametrize("name", ["Shimmer3-3d2C", "Shimmer3R-3D2c", "Shimmer3R-3D2C-BT"])
def test_a_shimmer_is_known_by_its_name(name: str) -> None:
    found = recognise(SerialPort("COM7", name, "00:06:66:AA:3D:2C"))
    assert found is not None
    assert (found.sensor, found.name) == ("shimmer", name)
    assert found.settings == {"unit": "3D2C", "port": "COM7"}


@pytest.mark.parametrize("name", ["", "Shimmer3", "Shimmer3R-3D2C-BLE", "Shimmer2-3D2C", "HC-05"])
def test_other_ports_are_not(name: str) -> None:
    assert recognise(SerialPort("COM7", name)) is None


def test_nor_is_anything_of_bluetooth_le() -> None:
    assert recognise(Advertisement("AA:BB:CC:DD:EE:FF", "Shimmer3-3D2C")) is None


def test_a_name_that_does_not_tell_the_board_is_a_gsr_unit_s() -> None:
    assert sensor("shimmer").precedence < sensor("shimmer3_gsr").precedence
