"""A virtual Polar Verity Sense, or a related optical sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from biosensor_gateway.devices.polar_h10.simulator import EXPECTED as STRAP
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10, Usual
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ACC_COMPRESSED_COUNTS,
    PPG_OF_TWO_DIODES,
    Measurement,
    Offered,
    Setting,
)
from biosensor_gateway.devices.polar_h10.simulator.products import Product
from biosensor_gateway.simulation.truth import Contact
from biosensor_gateway.simulation.virtual_device import Filled

EXPECTED = replace(
    STRAP,
    # Its contact channel has no role, because real devices are unreliable; this one is reliable.
    contact=Contact("quality", 0),
    without_contact=("hr", "ppi"),
    # The last interval of a batch ended at some time in the second before sending.
    unstamped_s={"hr": 0.0, "ppi": 0.8},
)

# Settings, rates and ranges are from the product pages in ``documentation/products`` of Polar's
# public SDK repository, and its ``KnownIssues.md``. The size of a count is from the start reply in
# Polar's specification for a Verity Sense at 8 g, else proportional to the range.
_OTHER_LOCATION = 0
_RATE, _BITS, _RANGE, _CHANNELS = (
    Setting.SAMPLE_RATE,
    Setting.RESOLUTION,
    Setting.RANGE,
    Setting.CHANNELS,
)
_UNITS_PER_RANGE = {
    Measurement.ACC: 0.000244 / 8,
    Measurement.GYRO: 0.07 / 2000,
    Measurement.MAGNETOMETER: 0.0015 / 50,
}
_FIELD: Offered = {_RATE: (10, 20, 50, 100), _BITS: (16,), _RANGE: (50,), _CHANNELS: (3,)}


def _light(*rates: int, bits: int = 22, channels: int = 4) -> Offered:
    return {_RATE: rates, _BITS: (bits,), _CHANNELS: (channels,)}


def _three_axes(rates: tuple[int, ...], ranges: tuple[int, ...]) -> Offered:
    return {_RATE: rates, _BITS: (16,), _RANGE: ranges, _CHANNELS: (3,)}


_VERITY_SDK: Mapping[Measurement, Offered] = {
    Measurement.PPG: _light(28, 44, 55, 135, 176),
    Measurement.ACC: _three_axes((26, 52, 104, 208, 416), (2, 4, 8, 16)),
    Measurement.GYRO: _three_axes((26, 52, 104, 208, 416), (250, 500, 1000, 2000)),
    Measurement.MAGNETOMETER: _FIELD,
}

VERITY_SENSE = Product(
    advertised="Polar Sense",
    model="Verity Sense",
    firmware="2.1.0",
    body_location=_OTHER_LOCATION,
    sends_rr=False,
    tells_contact=True,
    settings={
        Measurement.PPG: _light(55),
        Measurement.ACC: _three_axes((52,), (8,)),
        Measurement.PPI: {},
        Measurement.GYRO: _three_axes((52,), (2000,)),
        Measurement.MAGNETOMETER: _FIELD,
    },
    sdk_settings=_VERITY_SDK,
    start_parameters={},
    acc_format=ACC_COMPRESSED_COUNTS,
    units_per_range=_UNITS_PER_RANGE,
    # A smaller packet would only fit the reference sample of four channels.
    minimum_mtu=64,
)
OLD_VERITY_SENSE = replace(
    VERITY_SENSE,
    firmware="1.1.5",
    settings={**VERITY_SENSE.settings, Measurement.PPG: _light(135)},
    true_rates={Measurement.PPG: {135: 55}},
)
"""It reports 135 Hz but sends 55 Hz."""
OH1 = replace(
    VERITY_SENSE,
    advertised="Polar OH1",
    model="OH1",
    firmware="2.1.17",
    settings={
        Measurement.PPG: _light(130),
        Measurement.ACC: _three_axes((50,), (8,)),
        Measurement.PPI: {},
    },
    sdk_settings={},
    true_rates={Measurement.PPG: {130: 135}},
)
"""It reports 130 Hz but sends 135 Hz."""
POLAR_360 = replace(
    VERITY_SENSE,
    advertised="Polar 360",
    model="360",
    firmware="2.0.8",
    settings={
        Measurement.PPG: _light(22, bits=24, channels=2),
        Measurement.ACC: _three_axes((50,), (8,)),
        Measurement.PPI: {},
    },
    sdk_settings={
        Measurement.PPG: _light(22, 50, bits=24, channels=2),
        Measurement.ACC: _three_axes((12, 25, 50, 100, 200, 400), (2, 4, 8, 16)),
    },
    ppg_format=PPG_OF_TWO_DIODES,
)
"""Without its thermometer; its acceleration format is undocumented."""


class SimulatedPolarVeritySense(SimulatedPolarH10):
    """An optical sensor: light, pulse intervals and movement.

    Its heart rate is sent every second, every 5 s while intervals are measured, and not at all in
    SDK mode. It always reports the skin contact correctly.
    """

    sensor = "polar_verity_sense"
    each_own = MappingProxyType(
        {"address": "A0:9E:1A:5E:46:{number:02X}", "device_id": "5E46{number:04X}"}
    )
    usual = Usual(VERITY_SENSE, "A0:9E:1A:5E:45:E1", "5E45E001")
    expected = EXPECTED
    filled = MappingProxyType({"ppi": Filled(26, "it takes 25 s to find the first intervals")})
    rates_hz = MappingProxyType({"ppg": 55.0, "acc": 52.0, "gyro": 52.0, "mag": 50.0})
