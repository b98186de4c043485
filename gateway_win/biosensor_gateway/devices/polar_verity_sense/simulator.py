"""A virtual Polar Verity Sense, or another optical sensor of the family."""

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
from biosensor_gateway.simulation.expected import Contact
from biosensor_gateway.simulation.virtual_device import Filled

EXPECTED = replace(
    STRAP,
    # Its channel has no role, for real ones are not to be believed; the virtual one is.
    contact=Contact("quality", 0),
    without_contact=("hr", "ppi"),
    # Of a batch of intervals, the last was over at some time in the second before it was sent.
    unstamped_s={"hr": 0.0, "ppi": 0.8},
)

# Settings, rates and ranges: the product pages in ``documentation/products`` of Polar's public SDK
# repository, and its ``KnownIssues.md``. What a count is in each range: of a Verity Sense at 8 g
# from the start reply in Polar's specification, else in proportion to the range.
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
    # A reference sample of four channels fills a smaller packet.
    minimum_mtu=64,
)
OLD_VERITY_SENSE = replace(
    VERITY_SENSE,
    firmware="1.1.5",
    settings={**VERITY_SENSE.settings, Measurement.PPG: _light(135)},
    true_rates={Measurement.PPG: {135: 55}},
)
"""It says 135 Hz, and sends 55."""
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
"""It says 130 Hz, and sends 135."""
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
"""Without its thermometer; in which format it sends acceleration no document says."""


class SimulatedPolarVeritySense(SimulatedPolarH10):
    """An optical sensor: light, intervals between pulse waves, and what moves it.

    Its heart rate comes every second, every 5 s while intervals are measured, and not at all
    in the SDK mode. It always says whether it feels the skin, and says so rightly.
    """

    sensor = "polar_verity_sense"
    each_own = MappingProxyType(
        {"address": "A0:9E:1A:5E:46:{number:02X}", "device_id": "5E46{number:04X}"}
    )
    usual = Usual(VERITY_SENSE, "A0:9E:1A:5E:45:E1", "5E45E001")
    expected = EXPECTED
    filled = MappingProxyType({"ppi": Filled(26, "it takes 25 s to find the first intervals")})
    rates_hz = MappingProxyType({"ppg": 55.0, "acc": 52.0, "gyro": 52.0, "mag": 50.0})
