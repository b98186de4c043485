"""A virtual device that plays bytes of a real BioHarness 3."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from biosensor_gateway.devices.zephyr.simulator.bioharness import SimulatedBioHarness
from biosensor_gateway.devices.zephyr.simulator.recording import RecordedSource
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.simulation.world import World


class RecordedZephyr(VirtualDevice):
    """The recording of 150 s, from its start whenever it has ended.

    Its bytes cannot be changed, so it has only the faults of its link, and no truth.

    Parameters
    ----------
    world
        Where faults begin and end.
    kept
        Without effect.
    """

    sensor = "zephyr"
    faults = frozenset({FaultKind.DROP, FaultKind.STALL, FaultKind.GARBAGE})
    filled = MappingProxyType(
        {
            "hrv": Filled(76, "the recording's first valid value comes at 76 s"),
            "breathing": Filled(1, "the recording's first valid value comes at 1 s"),
            "st": Filled(None, "the recorded device never reports a valid value"),
        }
    )

    def __init__(self, world: World, *, kept: int | None = None) -> None:
        super().__init__(world, kept)
        source = RecordedSource.shipped(on_end="hang_up")
        self._device = SimulatedBioHarness(source, kept_packets=0)

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``port``."""
        return {"port": self._device.port}

    async def _start(self) -> None:
        self._device.start()

    async def _stop(self) -> None:
        self._device.stop()

    def _begin(self, fault: Fault) -> None:
        match fault.kind:
            case FaultKind.DROP:
                self._device.drop_link()
            case FaultKind.STALL:
                self._device.stall()
            case _:
                self._device.garbage(round(fault.value))

    def _end(self, kind: FaultKind) -> None:
        if kind is FaultKind.DROP:
            self._device.restore_link()
        else:
            self._device.resume()
