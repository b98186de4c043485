"""Which serial ports are Shimmers."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.shimmer3_gsr.driver import DRIVER, ShimmerSettings, recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort


@pytest.mark.parametrize("name", ["Shimmer3-9A3F", "Shimmer3-9a3f"])
def test_a_paired_shimmer_is_known_by_its_name(name: str) -> None:
    found = recognise(SerialPort("COM7", name, "00:06:66:46:9A:3F"))
    assert found == Found("shimmer3_gsr", name, {"unit": "9A3F", "port": "COM7"})
    settings = ShimmerSettings(sensor=found.sensor, **found.settings)  # type: ignore[arg-type]  # a mapping of scalars, as the file has it
    assert (settings.rate_hz, settings.gsr_range) == (128.0, "auto")


@pytest.mark.parametrize(
    "seen",
    [
        SerialPort("COM7"),
        SerialPort("COM7", "BH ZBH001234", "00:07:80:00:00:01"),
        SerialPort("COM7", "Shimmer3-9A3F2", "00:06:66:46:9A:3F"),
        Advertisement("00:06:66:46:9A:3F", "Shimmer3-9A3F"),
    ],
)
def test_others_are_not(seen: SerialPort | Advertisement) -> None:
    assert recognise(seen) is None


def test_the_driver_offers_it() -> None:
    assert DRIVER.recognise is recognise
    assert DRIVER.settings is ShimmerSettings
