"""A virtual Polar Verity Sense, or another optical sensor of the family."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from biosensor_gateway.devices.polar_h10.simulator.device import SimulatedPolarH10, Usual
from biosensor_gateway.devices.polar_verity_sense.simulator.expected import EXPECTED
from biosensor_gateway.devices.polar_verity_sense.simulator.products import VERITY_SENSE
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Wearer


class SimulatedPolarVeritySense(SimulatedPolarH10):
    """An optical sensor: light, intervals between pulse waves, and what moves it.

    Its heart rate comes every second, every 5 s while intervals are measured, and not at all
    in the SDK mode. It always says whether it feels the skin, and says so rightly.
    """

    sensor = "polar_verity_sense"
    usual = Usual(VERITY_SENSE, "A0:9E:1A:5E:45:E1", "5E45E001")
    expected = EXPECTED
    filled = MappingProxyType({"ppi": Filled(26, "it takes 25 s to find the first intervals")})
    rates_hz = MappingProxyType({"ppg": 55.0, "acc": 52.0, "gyro": 52.0, "mag": 50.0})

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Give each an address of its own, too."""
        own = {"address": f"A0:9E:1A:5E:46:{number:02X}", "device_id": f"5E46{number:04X}"}
        return {**super().worn_by(wearer, number), **own}
