"""Untidiness of Bluetooth LE: notifications in bundles, no name, another address."""

from __future__ import annotations

from types import MappingProxyType

from biosensor_gateway.simulation.effects import Effect, Effects, lasting
from biosensor_gateway.simulation.faults import Untidiness
from biosensor_gateway.simulation.peripheral import Peripheral


def _bundle(hit: Peripheral, seconds: float) -> None:
    hit.bundles.wait(seconds)


def _send_at_once(hit: Peripheral) -> None:
    hit.bundles.wait(0.0)


def _lose_name(hit: Peripheral) -> None:
    hit.set_nameless(True)


def _have_name(hit: Peripheral) -> None:
    hit.set_nameless(False)


def _change_address(hit: Peripheral) -> None:
    hit.set_address(_CHANGING + hit.address[2:])


def _have_address(hit: Peripheral) -> None:
    hit.set_address(hit.address)


_CHANGING = "5E"
"""Begins a resolvable private address, by its two highest bits: Core 5.4 Vol 6 Part B, 1.3.2.2."""

UNTIDY_RADIO: Effects[Peripheral] = MappingProxyType(
    {
        Untidiness.BUNDLED: Effect(_bundle, _send_at_once),
        Untidiness.NAMELESS: lasting(_lose_name, _have_name),
        Untidiness.READDRESSED: lasting(_change_address, _have_address),
    }
)
"""Effects on the radio of any device, a `Peripheral`."""
