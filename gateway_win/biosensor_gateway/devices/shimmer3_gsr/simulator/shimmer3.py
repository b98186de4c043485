"""A virtual Shimmer3 GSR+.

::

    with World() as world, SimulatedShimmer3(world) as device:
        serial.serial_for_url(device.port, 115200)
"""

from __future__ import annotations

from types import MappingProxyType

from biosensor_gateway.devices.shimmer.simulator.device import SimulatedShimmer
from biosensor_gateway.devices.shimmer.simulator.memory import Memory
from biosensor_gateway.devices.shimmer.simulator.streaming import Meter
from biosensor_gateway.devices.shimmer3_gsr.simulator.expected import EXPECTED
from biosensor_gateway.devices.shimmer3_gsr.simulator.inputs import Conditions, GsrMeter
from biosensor_gateway.simulation.virtual_device import Filled


class SimulatedShimmer3(SimulatedShimmer):
    """The device.

    Its `truth` holds ``gsr`` [uS], NaN while the electrodes are open; ``ppg`` [mV];
    ``bat`` [percent] of each answer about the battery; and ``quality`` at each change,
    with NaN for the pulse, which only a host looks for. The heart rate is the wearer's.
    Parameters are those of `SimulatedShimmer`.
    """

    sensor = "shimmer3_gsr"
    expected = EXPECTED
    filled = MappingProxyType({"hr": Filled(7, "it takes five heart beats")})
    memory = Memory()

    def _meter(self, channels: tuple[int, ...]) -> Meter:
        setting, divider = self._flash.gsr_range, self._flash.divider
        return GsrMeter(channels, setting, divider, self.wearer, self._conditions)

    def _conditions(self) -> Conditions:
        return Conditions(self._worn, bool(self._flash.expansion_power), self.battery_counts())
