"""A system clock that is stepped for some processes only; see ``stepped_clock.c``."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Self

from tests.rigs.compiler import compile_c

SOURCE = Path(__file__).with_suffix(".c")
_OFFSET = struct.Struct("=q")


class SteppedClock:
    """The clock of all processes that get its environment; a context manager.

    Parameters
    ----------
    folder
        Gets the library and the file that it reads the offset from.

    Raises
    ------
    CompilerError
        If there is no C compiler, or it fails.
    """

    def __init__(self, folder: Path) -> None:
        library, self._file = folder / "stepped_clock.so", folder / "offset"
        compile_c(SOURCE, library, "-shared", "-fPIC", "-ldl")
        self._file.write_bytes(_OFFSET.pack(0))
        self._opened = self._file.open("r+b")
        self._page = mmap.mmap(self._opened.fileno(), _OFFSET.size)
        self.environment = {"LD_PRELOAD": str(library), "STEPPED_CLOCK": str(self._file)}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._page.close()
        self._opened.close()

    def set_offset(self, offset_ns: int) -> None:
        """Let the clock be so much ahead of the true one from now on."""
        # Eight aligned bytes are written at once.
        self._page[:] = _OFFSET.pack(offset_ns)
