"""Mounts that only a test sees, through the root folder of a process in a namespace of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Self

# It says when the mounts are made, then waits until its standard input is closed.
_HOLD = "echo ready && exec cat"


class MountNamespace:
    """Makes mounts in a namespace that ends with the block; needs root.

    Parameters
    ----------
    commands
        Lines of shell that mount something.
    """

    def __init__(self, *commands: str) -> None:
        script = " && ".join([*commands, _HOLD])
        self._holder = subprocess.Popen(
            ["unshare", "--mount", "--propagation", "private", "sh", "-c", script],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def __enter__(self) -> Self:
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == b"ready\n", "nothing could be mounted"
        return self

    def __exit__(self, *_: object) -> None:
        self._holder.communicate(timeout=30)

    def path(self, inside: Path) -> Path:
        """Where everybody else finds a folder as it is in the namespace."""
        return Path(f"/proc/{self._holder.pid}/root{inside}")
