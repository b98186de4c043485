"""The Windows CPython that a bundle was made with."""

from __future__ import annotations

import hashlib
from functools import cached_property
from pathlib import Path, PurePosixPath

NAME = "cpython"
_BINARIES = ("*.dll", "DLLs/*.dll", "DLLs/*.pyd")


class CPython:
    """An unpacked or installed CPython.

    Parameters
    ----------
    folder
        Has ``python.exe``, ``DLLs``, ``Lib`` and ``LICENSE.txt``.
    """

    def __init__(self, folder: Path) -> None:
        self._library = folder / "Lib"
        self._folder = folder

    @property
    def licence_text(self) -> Path:
        """Where the licence text is."""
        return self._folder / "LICENSE.txt"

    def has_module(self, name: str) -> bool:
        """Tell whether a module is of the standard library."""
        path = PurePosixPath(*name.split("."))
        if path.parts[0] == "site-packages":
            return False
        return any(
            (self._library / each).is_file()
            for each in (path.with_name(path.name + ".py"), path / "__init__.py")
        )

    @cached_property
    def binaries(self) -> frozenset[str]:
        """SHA-256 (hex) of each of its libraries and extension modules."""
        found = (path for pattern in _BINARIES for path in self._folder.glob(pattern))
        return frozenset(hashlib.sha256(path.read_bytes()).hexdigest() for path in found)
