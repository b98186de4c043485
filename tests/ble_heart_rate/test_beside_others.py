"""A strap's table without `device`, beside other tables of the settings."""

from __future__ import annotations

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice
from tests.rigs.driver_run import Run, supervised
from tests.rigs.polling import until


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
