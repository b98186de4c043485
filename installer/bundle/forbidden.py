"""Finds what must never be in a bundle."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from installer.bundle.binaries import is_wines
from installer.bundle.errors import ForbiddenFileError
from installer.bundle.names import base_name

# Windows has its own, and these would shadow them; under Wine they are even Wine's.
_SYSTEM = re.compile(r"(ucrtbased?|bcryptprimitives)\.dll|(api|ext)-ms-.*\.dll", re.IGNORECASE)
_SYSTEM_REASON = "a part of Windows"
_WINE_REASON = "a library of Wine"
# Parts of a path or of a dotted name.
_UNWANTED = {
    "lsl_to_ros": "the ROS side",
    "pytest": "a test tool",
    "_pytest": "a test tool",
    "test": "tests",
    "tests": "tests",
}
_BINARY = (".dll", ".exe", ".pyd")


def refuse_forbidden(bundle: Path, paths: Iterable[str], modules: Iterable[str]) -> None:
    """Look for what must not be shipped.

    Parameters
    ----------
    bundle
        The bundle's folder.
    paths
        Its files, below the folder, with ``/``.
    modules
        Dotted names of the modules in its archives.

    Raises
    ------
    ForbiddenFileError
        If there is any; names each, and why.
    """
    found = {path: _file_reason(bundle / path, path) for path in paths}
    found |= {f"module {name}": _part_reason(name.split(".")) for name in modules}
    named = [f"{name} ({reason})" for name, reason in sorted(found.items()) if reason]
    if named:
        message = f"The bundle must not hold {', '.join(named)}; exclude it where it is frozen."
        raise ForbiddenFileError(message)


def _file_reason(file: Path, path: str) -> str | None:
    if _SYSTEM.fullmatch(base_name(path)):
        return _SYSTEM_REASON
    if file.suffix.lower() in _BINARY and is_wines(file.read_bytes()):
        return _WINE_REASON
    return _part_reason(path.split("/"))


def _part_reason(parts: Iterable[str]) -> str | None:
    # "pytest-9.0.dist-info" counts as "pytest", "tests.py" as "tests".
    stems = (re.split(r"[-.]", part)[0].lower() for part in parts)
    return next((_UNWANTED[stem] for stem in stems if stem in _UNWANTED), None)
