"""A system clock that is stepped for some processes only; see ``stepped_clock.c``."""

from __future__ import annotations

import mmap
import struct
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

SOURCE = Path(__file__).with_suffix(".c")
_FLAGS = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
_OFFSET = struct.Struct("=q")


class CompilerError(Exception):
    """What steps the clock cannot be compiled; says why."""


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
        _compile(library)
        self._file.write_bytes(_OFFSET.pack(0))
        self._opened = self._file.open("r+b")
        self._page = mmap.mmap(self._opened.fileno(), _OFFSET.size)
        self.environment = {"LD_PRELOAD": str(library), "STEPPED_CLOCK": str(self._file)}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._page.close()
        self._opened.close()

    def set_offset(self, offset_ns: int) -> None:
        """Let the clock be so much ahead of the true one from now on."""
        # Eight aligned bytes are written at once.
        self._page[:] = _OFFSET.pack(offset_ns)


def _compile(library: Path) -> None:
    command = ["cc", *_FLAGS, "-o", str(library), str(SOURCE), "-ldl"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        needed = "install a C compiler, as tests/system/packages.txt has it"
        raise CompilerError(f"cc cannot be run ({error.strerror}); {needed}") from error
    if done.returncode:
        raise CompilerError(f"{SOURCE.name} cannot be compiled\n{done.stderr}")
