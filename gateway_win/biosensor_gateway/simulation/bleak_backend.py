"""A platform backend of bleak whose radio is virtual.

While `virtual_bluetooth` lasts, code that uses plain ``BleakScanner`` and
``BleakClient`` talks to virtual devices, and sees what it would see on Windows, macOS
or Linux: a local disconnect calls back as well as a lost link, requests fail when the
link goes, and so on.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import bleak
import bleak.backends.adapter
import bleak.backends.client
import bleak.backends.scanner
from bleak.backends.adapter import BaseBleakAdapter

from biosensor_gateway.simulation.bleak_client import VirtualClient
from biosensor_gateway.simulation.bleak_scanner import VirtualScanner
from biosensor_gateway.simulation.central import Central
from biosensor_gateway.simulation.radio import Radio

_BACKEND_ID = "virtual"
_PICKERS: dict[str, ModuleType] = {
    "get_platform_scanner_backend_type": bleak.backends.scanner,
    "get_platform_client_backend_type": bleak.backends.client,
    "get_platform_adapter_backend_type": bleak.backends.adapter,
}


@contextmanager
def virtual_bluetooth(radio: Radio) -> Generator[None]:
    """Have bleak, in every loop and thread of this process, use a virtual radio.

    Raises
    ------
    RuntimeError
        If this version of bleak picks its backends otherwise than is known here.
    """
    originals = _originals()
    central = radio.world.await_(Central.on_the_air(radio))
    backends = (partial(VirtualScanner, central), partial(VirtualClient, central), BaseBleakAdapter)
    for name, backend in zip(_PICKERS, backends, strict=True):
        _replace(name, partial(_pick, backend))
    try:
        yield
    finally:
        for name, original in originals.items():
            _replace(name, original)
        radio.world.await_(central.close())


def _pick(backend: object) -> tuple[object, str]:
    return backend, _BACKEND_ID


def _originals() -> dict[str, Any]:
    originals = {name: getattr(module, name, None) for name, module in _PICKERS.items()}
    for name, original in originals.items():
        if original is None or getattr(bleak, name, None) is not original:
            raise RuntimeError(
                f"bleak has no {name} any more; the virtual radio stands in for that of bleak 3.1"
            )
    return originals


def _replace(name: str, function: object) -> None:
    for module in (bleak, _PICKERS[name]):
        setattr(module, name, function)
