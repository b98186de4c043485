"""A virtual device that plays bytes of a real BioHarness 3."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from biosensor_gateway.devices.zephyr.simulator.bioharness import BioHarness
from biosensor_gateway.devices.zephyr.simulator.recording import RecordedSource
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World


class RecordedZephyr(BioHarness):
    """The recording of 150 s, from its start whenever it has ended.

    Its bytes cannot be changed, so it has only the faults of its link, and no truth.

    Parameters
    ----------
    world
        Where it lives.
    kept
        Without effect.
    """

    filled = MappingProxyType(
        {
            "hrv": Filled(76, "the recording's first valid value comes at 76 s"),
            "breathing": Filled(1, "the recording's first valid value comes at 1 s"),
            "st": Filled(None, "the recorded device never reports a valid value"),
        }
    )

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Play the same for everybody."""
        del wearer, number
        return {}

    def __init__(self, world: World, *, kept: int | None = None) -> None:
        super().__init__(world, RecordedSource.shipped(on_end="hang_up"), kept=kept)
