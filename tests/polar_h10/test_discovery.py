"""Which advertisements are those of an H10, and the settings they make."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.driver import PolarH10Settings, identify, recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})
POLAR = {0x006B: bytes.fromhex("33000038")}


def seen(name: str, uuids: frozenset[str] = HEART_RATE) -> Advertisement:
    return Advertisement("A0:9E:1A:00:00:01", name, -58, uuids)


def test_the_id_on_the_sensor_names_it_and_its_address_leads_to_it() -> None:
    found = recognise(seen("Polar H10 A1B2C3D4"))
    assert found is not None
    assert (found.sensor, found.rssi_dbm) == ("polar_h10", -58)
    assert found.name == "Polar H10 A1B2C3D4"
    settings = PolarH10Settings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("A1B2C3D4", "A0:9E:1A:00:00:01")


def test_the_maker_s_number_is_as_good_as_the_service() -> None:
    name = "Polar H10 A1B2C3D4"
    assert identify(Advertisement("A0:9E:1A:00:00:01", name, manufacturer_data=POLAR)) == "A1B2C3D4"
    assert identify(seen(name, frozenset())) is None


@pytest.mark.parametrize(
    "name",
    [
        "",
        "   ",
        "Polar",
        "Polar H10",
        "Polar H9 A1B2C3D4",
        "Polar Sense A1B2C3D4",
        "Polar Vantage V3 A1B2C3D4",
        "Polaris H10 A1B2C3D4",
        "My Polar H10 A1B2C3D4",
    ],
)
def test_other_names_are_other_devices(name: str) -> None:
    assert identify(seen(name)) is None
    assert recognise(seen(name)) is None


def test_a_serial_port_is_none() -> None:
    assert recognise(SerialPort("COM7", "Polar H10 A1B2C3D4")) is None


@given(st.text(max_size=60))
def test_no_name_is_too_strange(name: str) -> None:
    assert identify(seen(name)) is None or name.split(maxsplit=1)[0] == "Polar"
