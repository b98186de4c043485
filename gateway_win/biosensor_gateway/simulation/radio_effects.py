"""Faults of the radio of any Bluetooth LE device: lost links, bundles, no name, other addresses."""

from __future__ import annotations

from types import MappingProxyType

from biosensor_gateway.simulation.effects import Effect, Effects, flag, lasting
from biosensor_gateway.simulation.faults import FaultKind, Untidiness
from biosensor_gateway.simulation.peripheral import Peripheral

_CHANGING = "5E"
"""Begins a resolvable private address, by its two highest bits: Core 5.4 Vol 6 Part B, 1.3.2.2."""

RADIO_EFFECTS: Effects[Peripheral] = MappingProxyType(
    {
        FaultKind.DROP: lasting(Peripheral.drop, Peripheral.restore),
        FaultKind.STALL: flag("stalled"),
        Untidiness.BUNDLED: Effect(
            lambda hit, seconds: hit.bundles.wait(seconds), lambda hit: hit.bundles.wait(0.0)
        ),
        Untidiness.NAMELESS: lasting(
            lambda hit: hit.set_nameless(True), lambda hit: hit.set_nameless(False)
        ),
        Untidiness.READDRESSED: lasting(
            lambda hit: hit.set_address(_CHANGING + hit.address[2:]),
            lambda hit: hit.set_address(hit.address),
        ),
    }
)
