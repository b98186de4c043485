"""What the settings of a Shimmer take, and how they refuse the rest."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from biosensor_gateway.devices.registry import sensor
from biosensor_gateway.devices.shimmer.driver import Shimmer3Settings, Wanted, recognise
from biosensor_gateway.transports.nearby import Advertisement, SerialPort


def settings(**fields: object) -> Shimmer3Settings:
    named = {"sensor": "shimmer", "unit": "3D2C", "port": "COM7"}
    return Shimmer3Settings.model_validate({**named, **fields})


def test_by_default_all_is_left_as_the_device_has_it() -> None:
    assert settings().wanted == Wanted()


def test_names_choose_sensors() -> None:
    wanted = settings(sensors="ecg, gyro,pressure", rate_hz=500, exg_bits=16, exg_gain=8).wanted
    assert wanted == Wanted(frozenset({"ecg", "gyro", "pressure"}), 66, 16, 8)
    assert wanted.use == "ecg"


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"sensors": "ecg, eeg"}, "but has 'eeg'"),
        ({"sensors": ""}, "but has ''"),
        ({"sensors": "ecg,emg"}, "need the same chips"),
        ({"rate_hz": 0.4}, "should be 0, or from 1 to 2048"),
        ({"rate_hz": 4096.0}, "less than or equal to 2048"),
        ({"exg_gain": 5}, "should be 'usual', 1, 2, 3, 4, 6, 8 or 12"),
        ({"exg_bits": 20}, "should be 16 or 24"),
    ],
)
def test_what_makes_no_sense_is_refused(fields: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(**fields)
    assert sentence in str(caught.value)


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
