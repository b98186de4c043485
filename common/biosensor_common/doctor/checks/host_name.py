"""Checks the name of this computer, which is in the header of every stream."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterator

from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, ok, warning

_PLAIN = re.compile(r"[A-Za-z0-9._-]+")


def examine(_context: Context) -> Iterator[Finding]:
    """Look for characters that LSL programs stumble over."""
    yield judge(socket.gethostname())


def judge(name: str) -> Finding:
    """Judge a name."""
    if _PLAIN.fullmatch(name):
        return ok(f"this computer is called {name}")
    return warning(
        f"this computer is called {name!r}",
        "LabRecorder cannot require streams of a computer with a blank in its name, and letters "
        "outside ASCII stop some LSL programs.",
        "Settings > System > About > Rename this PC"
        if sys.platform == "win32"
        else "sudo hostnamectl set-hostname NAME, with letters, digits and '-' only",
    )
