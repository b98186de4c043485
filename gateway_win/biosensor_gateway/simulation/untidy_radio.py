"""Untidiness of Bluetooth LE: notifications in bundles, advertisements without a name."""

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


UNTIDY_RADIO: Effects[Peripheral] = MappingProxyType(
    {
        Untidiness.BUNDLED: Effect(_bundle, _send_at_once),
        Untidiness.NAMELESS: lasting(_lose_name, _have_name),
    }
)
"""Effects on the radio of any device, a `Peripheral`."""
