"""Which advertisements are heart-rate straps, and how they come into the settings."""

from __future__ import annotations

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.ble_heart_rate.driver import (
    HeartRateStrapSettings,
    identify,
    identify_any,
    recognise,
)
from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.driver_run import Run, supervised
from tests.rigs.polling import until

ADDRESS = "C8:25:00:00:00:01"
HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})


def seen(name: str = "TICKR 1234", *, heart_rate: bool = True) -> Advertisement:
    return Advertisement(ADDRESS, name, -60, HEART_RATE if heart_rate else frozenset())


def test_a_strap_is_found_with_the_settings_that_lead_to_it() -> None:
    found = recognise(seen())
    assert found is not None
    assert (found.sensor, found.name, found.rssi_dbm) == ("ble_heart_rate", "TICKR 1234", -60)
    settings = HeartRateStrapSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert settings.device == identify(seen()) == ADDRESS


def test_a_strap_without_a_name_is_called_by_its_address() -> None:
    found = recognise(seen(""))
    assert found is not None
    assert found.name == ADDRESS


@pytest.mark.parametrize(
    ("model", "sensor"),
    [
        ("H10", "polar_h10"),
        ("Sense", "polar_verity_sense"),
        ("Verity Sense", "polar_verity_sense"),
        ("OH1", "polar_verity_sense"),
        ("360", "polar_verity_sense"),
    ],
)
def test_what_has_a_driver_of_its_own_is_left_to_it(model: str, sensor: str) -> None:
    found = recognised(drivers_by_precedence(), seen(f"Polar {model} A1B2C3D4"))
    assert found is not None
    assert found.sensor == sensor
    # It may be chosen all the same.
    assert identify(seen(f"Polar {model} A1B2C3D4")) == ADDRESS


def test_a_strap_of_the_same_maker_is_one() -> None:
    found = recognised(drivers_by_precedence(), seen("Polar H9 A1B2C3D4"))
    assert found is not None
    assert found.sensor == "ble_heart_rate"


def test_anything_else_is_none() -> None:
    assert recognise(seen(heart_rate=False)) is None
    assert identify(seen(heart_rate=False)) is None
    assert recognise(SerialPort("COM7", "TICKR 1234")) is None


def test_a_strap_that_does_not_say_so_can_be_chosen() -> None:
    assert identify_any(seen(heart_rate=False)) == ADDRESS


@pytest.mark.parametrize("device", ["", "A1B2C3D4"])
async def test_an_h10_of_another_table_is_not_taken(
    radio: Radio, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(ble_choice, "SCAN_S", 1.5)
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)
    strap = SimulatedHeartRateStrap(radio.world, radio)
    with SimulatedPolarH10(radio.world, radio) as h10:
        straps, polars = Run(strap, device=""), Run(h10, device=device)
        async with supervised(straps), supervised(polars):
            await until(polars.sink.has(1, "hr"))
            await until(lambda: straps.supervisor.last_error)
            assert not straps.sink.rows["hr"]
            with strap:
                await until(straps.sink.has(1, "hr"))
                assert straps.sink.info.model == "Heart Strap"
