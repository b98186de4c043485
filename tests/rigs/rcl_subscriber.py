"""A subscriber in C, as ``tutorial_subscriber`` is one in Python; see ``rcl_subscriber.c``.

    python -m tests.rigs.rcl_subscriber LIBRARY DEPTH reliable|best_effort TOPIC TYPE...

A library of ROS's wheels wants symbols of Python's, so the program is a library, too, and Python
loads it. From then on this process is in C alone.
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

from tests.rigs.compiler import compile_c

_SOURCE = Path(__file__).with_suffix(".c")
_LIBRARIES = ("-lrcl", "-lrcutils", "-lpthread", "-ldl")


def build(folder: Path) -> Path:
    """Compile it against ROS's wheels; return the library.

    Raises
    ------
    CompilerError
        If there is no C compiler, or it fails.
    """
    library, ros = folder / "rcl_subscriber.so", Path(sys.prefix)
    headers = [f"-I{package}" for package in sorted((ros / "include").iterdir())]
    compile_c(_SOURCE, library, "-shared", "-fPIC", *headers, f"-L{ros / 'lib'}", *_LIBRARIES)
    return library


def main() -> None:
    """Subscribe until standard input ends."""
    library, *words = sys.argv[1:]
    arguments = [word.encode() for word in (library, *words)]
    ctypes.CDLL(library).subscribe_to_all(
        len(arguments), (ctypes.c_char_p * len(arguments))(*arguments)
    )


if __name__ == "__main__":
    main()
