"""How this program starts itself again, for another task."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

_PROGRAM = "biosensor-gateway.exe"


def own_command(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs this program with arguments.

    An installed one has two programs in its folder; this is the one with a console.
    """
    if getattr(sys, "frozen", False):
        return [str(Path(sys.executable).with_name(_PROGRAM)), *arguments]
    return [sys.executable, "-P", "-m", "biosensor_gateway.cli", *arguments]
