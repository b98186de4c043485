"""Versions and places of the programs and libraries involved."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Finding, error, ok, warning

_LIBRARIES = ("bleak", "numpy")
_OLDEST_LIBLSL = 117
_INSTALL = f"{sys.executable} -m pip install --force-reinstall"


def examine(_context: Context) -> Iterator[Finding]:
    """Say what runs here."""
    yield ok(f"{platform.platform()}, {platform.machine()}")
    yield _gateway()
    yield ok(f"Python {platform.python_version()}, {sys.executable}")
    yield from _lsl()
    for name in _LIBRARIES:
        yield _library(name)


def _gateway() -> Finding:
    # The folder of the package; a frozen program's is beside its exe.
    place = Path(__file__).parents[2]
    try:
        return ok(f"biosensor-gateway {version('biosensor-gateway')}, {place}")
    except PackageNotFoundError:
        return warning(
            f"biosensor-gateway is not installed; it runs from {place}",
            "Its version is unknown, and so are the versions of what it needs.",
            f"in the folder of the project: {sys.executable} -m pip install .",
        )


def _lsl() -> Iterator[Finding]:
    try:
        # Without its library, importing it fails.
        import pylsl  # noqa: PLC0415
        from pylsl.lib import lib  # noqa: PLC0415
    except (ImportError, OSError, RuntimeError) as problem:
        yield error(
            f"pylsl cannot be used: {_first_line(problem)}",
            "Without the Lab Streaming Layer's library (liblsl) there are no streams.",
            _missing_liblsl(),
        )
        return
    yield ok(f"pylsl {version('pylsl')}, {Path(pylsl.__file__).parent}")
    number = pylsl.library_version()
    what = f"liblsl {number // 100}.{number % 100} ({pylsl.library_info()}), {lib._name}"  # noqa: SLF001 - ctypes has no other name for it
    if number >= _OLDEST_LIBLSL and hasattr(lib, "lsl_set_config_content"):
        yield ok(what)
        return
    yield error(
        f"{what} is too old",
        "The agent passes its configuration on in a way that liblsl knows since 1.17.7.",
        f"remove the old library or the variable PYLSL_LIB that names it, then: {_INSTALL} pylsl",
    )


def _library(name: str) -> Finding:
    try:
        module = import_module(name)
    except Exception as problem:  # noqa: BLE001 - parts of the system may be missing to it
        return error(
            f"{name} cannot be used: {_first_line(problem)}",
            "The agent cannot start without it.",
            f"{_INSTALL} {name}",
        )
    return ok(f"{name} {version(name)}, {Path(module.__file__ or '').parent}")


def _missing_liblsl() -> str:
    if sys.platform == "linux" and platform.machine() not in {"x86_64", "AMD64"}:
        return (
            "pylsl brings no liblsl for this processor: install it from "
            "https://github.com/sccn/liblsl/releases or build it, then set PYLSL_LIB to the "
            "path of liblsl.so"
        )
    return f"{_INSTALL} pylsl"


def _first_line(problem: BaseException) -> str:
    lines = str(problem).splitlines()
    return lines[0] if lines else type(problem).__name__
