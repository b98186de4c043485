"""Shows versions and places of the programs and libraries involved."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from biosensor_common import liblsl
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, ok, warning
from biosensor_common.doctor.guide import Guide

_OLDEST_LIBLSL = 117
# Between two of what liblsl tells of its build; a branch has slashes of its own.
_DETAIL = re.compile(r"/(?=\w+:)")


def examine(context: Context) -> Iterator[Finding]:
    """Say what runs here."""
    guide = context.guide
    yield ok(f"{platform.platform()}, {platform.machine()}")
    yield _program(guide)
    yield ok(f"Python {platform.python_version()}, {sys.executable}")
    yield from _lsl(guide)
    for name, install in guide.libraries.items():
        yield _library(name, install, guide)


def _program(guide: Guide) -> Finding:
    # The folder of the package; a frozen program's is beside its exe.
    place = Path(import_module(guide.package).__file__ or "").parent
    try:
        return ok(f"{guide.distribution} {version(guide.distribution)}, {place}")
    except PackageNotFoundError:
        return warning(
            f"{guide.distribution} is not installed; it runs from {place}",
            "Its version is unknown, and so are the versions of what it needs.",
            guide.install,
        )


def _lsl(guide: Guide) -> Iterator[Finding]:
    try:
        # Without its library, importing it fails.
        import pylsl
        from pylsl.lib import lib
    except (ImportError, OSError, RuntimeError) as problem:
        yield error(
            f"pylsl cannot be used: {_first_line(problem)}",
            "Without the Lab Streaming Layer's library (liblsl) there are no streams.",
            liblsl.remedy(guide.install_pylsl),
        )
        return
    yield ok(f"pylsl {version('pylsl')}, {Path(pylsl.__file__).parent}")
    number = pylsl.library_version()
    # One word of 120 letters would be broken anywhere.
    details = _DETAIL.sub(", ", pylsl.library_info())
    what = f"liblsl {number // 100}.{number % 100} ({details}), {lib._name}"  # noqa: SLF001 - ctypes has no other name for it
    if number >= _OLDEST_LIBLSL and hasattr(lib, "lsl_set_config_content"):
        yield ok(what)
        return
    yield error(
        f"{what} is too old",
        "Its configuration is passed on in a way that it knows since 1.17.7.",
        "remove the old library or the variable PYLSL_LIB that names it, then: "
        + guide.install_pylsl,
    )


def _library(name: str, install: str, guide: Guide) -> Finding:
    try:
        module = import_module(name)
    except Exception as problem:  # noqa: BLE001 - parts of the system may be missing to it
        return error(
            f"{name} cannot be used: {_first_line(problem)}",
            f"{guide.program.capitalize()} cannot start without it.",
            install,
        )
    return ok(f"{name} {_version(name)}, {Path(module.__file__ or '').parent}")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "of an unknown version"


def _first_line(problem: BaseException) -> str:
    lines = str(problem).splitlines()
    return lines[0] if lines else type(problem).__name__
