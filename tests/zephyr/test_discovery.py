"""Which serial ports are those of a paired BioHarness."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.zephyr.driver.driver import recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort


@pytest.mark.parametrize("name", ["BH BHT012345", "BHBHT012345"])
def test_a_paired_bioharness_is_found_by_the_name_of_its_port(name: str) -> None:
    settings = {"unit": "BHT012345", "port": "COM7"}
    assert recognise(SerialPort("COM7", name)) == Found("zephyr", name, settings)


@pytest.mark.parametrize(
    "seen",
    [
        SerialPort("COM7"),
        SerialPort("COM7", "Shimmer3-1234"),
        SerialPort("COM7", "BH BHT012345 2"),
        Advertisement("00:07:80:5A:3E:7E", "BH BHT012345"),
    ],
)
def test_others_are_none(seen: SerialPort | Advertisement) -> None:
    assert recognise(seen) is None
