"""The C compiler of this machine."""

from __future__ import annotations

import subprocess
from pathlib import Path

_FLAGS = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror")


class CompilerError(Exception):
    """A source of the tests cannot be compiled; says why."""


def compile_c(source: Path, target: Path, *options: str) -> None:
    """Compile a source into a library or program.

    Parameters
    ----------
    options
        For the compiler, after its source.

    Raises
    ------
    CompilerError
        If there is no C compiler, or it fails.
    """
    command = ["cc", *_FLAGS, "-o", str(target), str(source), *options]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        needed = "install a C compiler, as tests/system/packages.txt has it"
        raise CompilerError(f"cc cannot be run ({error.strerror}); {needed}") from error
    if done.returncode:
        raise CompilerError(f"{source.name} cannot be compiled\n{done.stderr}")
