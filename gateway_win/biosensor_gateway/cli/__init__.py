"""The command line: ``biosensor-gateway``."""

from __future__ import annotations

import io
import sys
from typing import TextIO

from biosensor_gateway.system.own_window import HeldOpen, is_own_window

__all__ = ["main"]

KEEP_ALIVE = "--keep-alive"


def main() -> None:
    """Run the command line; see `biosensor_gateway.cli.app`."""
    with HeldOpen():
        _run()


def _run() -> None:
    _say_anything()
    if len(sys.argv) == 1 and is_own_window():
        # Started by a double click: there is nobody who would read a list of commands.
        sys.argv += ["run", "--ask"]
    if sys.argv[1:2] == ["run"]:
        if KEEP_ALIVE in sys.argv:
            from biosensor_gateway.system.keep_alive import keep_alive  # noqa: PLC0415 - only then

            # Here, because who waits for an agent to die needs nothing that an agent needs.
            sys.exit(keep_alive([each for each in sys.argv[1:] if each != KEEP_ALIVE]))
        from biosensor_gateway.system.shutdown import end_quietly_until_running  # noqa: PLC0415 - asyncio

        # What it needs takes a second to import, and a service may be stopped as it starts.
        end_quietly_until_running()
    from biosensor_gateway.cli import app  # noqa: PLC0415 - only now

    app.main()


def _say_anything() -> None:
    """Write what an output has no letter for as an escape: Windows' pipes know 256 letters.

    What is typed and is no letter is a wrong answer like any other.
    """
    typed: TextIO | None = sys.stdin
    if isinstance(typed, io.TextIOWrapper):
        typed.reconfigure(errors="replace")
    for stream in (sys.stdout, sys.stderr):
        # A program without a console on Windows has neither.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
