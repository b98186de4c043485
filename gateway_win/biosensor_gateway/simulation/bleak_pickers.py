"""Makes bleak use other backends than the system's."""

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

Backends = tuple[object, object, object]
"""Functions that create a scanner, a client and an adapter."""

_BACKEND_ID = "virtual"
_PICKERS: dict[str, ModuleType] = {
    "get_platform_scanner_backend_type": bleak.backends.scanner,
    "get_platform_client_backend_type": bleak.backends.client,
    "get_platform_adapter_backend_type": bleak.backends.adapter,
}


@contextmanager
def standing_in(backends: Backends) -> Generator[None]:
    """Let bleak use these backends, in all event loops and threads of this process.

    Raises
    ------
    RuntimeError
        If this version of bleak picks its backends otherwise than is known here.
    """
    originals = _originals()
    for name, backend in zip(_PICKERS, backends, strict=True):
        _replace(name, partial(_pick, backend))
    try:
        yield
    finally:
        for name, original in originals.items():
            _replace(name, original)


def _pick(backend: object) -> tuple[object, str]:
    return backend, _BACKEND_ID


def _originals() -> dict[str, Any]:
    originals = {name: getattr(module, name, None) for name, module in _PICKERS.items()}
    for name, original in originals.items():
        if original is None or getattr(bleak, name, None) is not original:
            raise RuntimeError(
                f"bleak no longer has {name}; the virtual radio replaces that of bleak 3.1"
            )
    return originals


def _replace(name: str, function: object) -> None:
    for module in (bleak, _PICKERS[name]):
        setattr(module, name, function)
