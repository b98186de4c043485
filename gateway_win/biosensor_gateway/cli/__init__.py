"""The command line: ``biosensor-gateway``."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import TextIO

from biosensor_common import liblsl
from biosensor_common.process_limits import raise_limit

__all__ = ["main"]

BEGUN_S = time.perf_counter()
"""About when the command was given; what it needs takes long to import."""

KEEP_ALIVE = "--keep-alive"
KEEP_RECORDING = "keep-recording"
"""Not for people: this process is then the supervisor of a recording."""
RECORD_STREAMS = "record-streams"
"""Likewise: it records in the place of LabRecorder's program."""
PLAY_RECORDING = "play-recording"
"""Likewise: it plays one, for the page."""
SEND_FEATURES = "send-features"
"""Likewise: it sends features beside an agent."""


def main() -> None:
    """Run the command line; see `biosensor_gateway.cli.app`."""
    with contextlib.ExitStack() as stack:
        stack.push(_hold_window_of_a_failure)
        _run()


def _run() -> None:
    _say_anything()
    # First, so that whatever is started from here inherits it.
    raise_limit()
    liblsl.provide(os.environ)
    if len(sys.argv) == 1:
        _lead_after_a_double_click()
    if sys.argv[1:2] == [KEEP_RECORDING]:
        from biosensor_gateway.recording.recorder.supervisor import supervise  # only then

        sys.exit(supervise(Path(sys.argv[2])))
    if sys.argv[1:2] == [RECORD_STREAMS]:
        from biosensor_gateway.recording.recorder.receiver import record_streams  # only then

        sys.exit(record_streams(Path(sys.argv[2]), sys.argv[3]))
    if sys.argv[1:2] == [PLAY_RECORDING]:
        from biosensor_gateway.recording.replay.player_process import play_for_another  # only then

        sys.exit(play_for_another())
    if sys.argv[1:2] == [SEND_FEATURES]:
        from biosensor_gateway.features.feature_process import send_for_another  # only then

        sys.exit(send_for_another())
    if sys.argv[1:2] == ["run"]:
        if KEEP_ALIVE in sys.argv:
            from biosensor_gateway.system.keep_alive import keep_alive  # only then

            # Here, because who waits for an agent to die needs nothing that an agent needs.
            sys.exit(keep_alive([each for each in sys.argv[1:] if each != KEEP_ALIVE]))
        from biosensor_gateway.system.shutdown import end_quietly_until_running  # asyncio

        # What it needs takes a second to import, and a service may be stopped as it starts.
        end_quietly_until_running()
    from biosensor_gateway.cli import app  # only now

    app.main()


def _lead_after_a_double_click() -> None:
    from biosensor_gateway.system.windows_console import has_a_reader, is_own_window  # only now

    if is_own_window() and has_a_reader():
        # There is nobody who would read a list of commands.
        sys.argv += ["run", "--ask"]


def _hold_window_of_a_failure(
    _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
) -> None:
    if error is None or (isinstance(error, SystemExit) and not error.code):
        return
    from biosensor_gateway.system.windows_console import hold_open  # only now

    hold_open()


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
