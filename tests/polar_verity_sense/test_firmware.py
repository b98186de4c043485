"""Which firmware says which rate wrong."""

from __future__ import annotations

import pytest

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.polar_verity_sense.driver.driver import true_ppg_rates


@pytest.mark.parametrize(
    ("model", "firmware", "sdk_mode", "rates"),
    [
        ("Verity Sense", "1.1.4", False, {}),
        ("Verity Sense", "1.1.5", False, {135: 55}),
        ("Verity Sense", "2.0.9", False, {135: 55}),
        ("Verity Sense", "2.1.0", False, {}),
        ("Verity Sense", "1.1.5", True, {}),
        ("OH1", "2.1.17", False, {130: 135}),
        ("OH1+", "", False, {130: 135}),
        ("360", "2.0.8", False, {}),
        ("Verity Sense", "", False, {}),
        ("", "", False, {}),
    ],
)
def test_true_rates(model: str, firmware: str, *, sdk_mode: bool, rates: dict[int, int]) -> None:
    info = DeviceInfo(model=model, firmware_version=firmware)
    assert true_ppg_rates(info, sdk_mode=sdk_mode) == rates
