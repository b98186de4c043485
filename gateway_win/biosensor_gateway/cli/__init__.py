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
from biosensor_common.process_limits import INTERRUPTED, raise_limit

__all__ = ["main"]

BEGUN_S = time.perf_counter()
"""Time at which the command was given, before its imports, which can take a second."""

# The commands below are not for people: one of our own processes starts another one with them.
KEEP_ALIVE = "--keep-alive"
"""Supervise an agent and restart it after a crash."""
KEEP_RECORDING = "keep-recording"
"""Supervise a recording."""
RECORD_STREAMS = "record-streams"
"""Record streams to a file, as LabRecorder's program does."""
PLAY_RECORDING = "play-recording"
"""Play a recording for the page."""
SEND_FEATURES = "send-features"
"""Compute and send live features for an agent."""


def main() -> None:
    """Run the command line; see `biosensor_gateway.cli.app`."""
    with contextlib.ExitStack() as stack:
        stack.push(_keep_window_open_after_failure)
        try:
            _run()
        except KeyboardInterrupt:
            # During the imports; a command that has begun handles it by itself.
            sys.exit(INTERRUPTED)


def _run() -> None:
    _escape_unencodable_text()
    # Before anything is started, so that child processes inherit both.
    raise_limit()
    liblsl.provide(os.environ)
    if len(sys.argv) == 1:
        _ask_after_double_click()
    if sys.argv[1:2] == [KEEP_RECORDING]:
        from biosensor_gateway.recording.recorder.programs import supervise  # only then

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

            # Handled here because the supervisor needs none of the modules that an agent imports.
            sys.exit(keep_alive([each for each in sys.argv[1:] if each != KEEP_ALIVE]))
        from biosensor_gateway.system.shutdown import end_quietly_until_running  # asyncio

        # The agent's imports take a second, and a service manager may stop it meanwhile.
        end_quietly_until_running()
    from biosensor_gateway.cli import app  # only now

    app.main()


def _ask_after_double_click() -> None:
    from biosensor_gateway.system.windows_console import has_a_reader, is_own_window  # only now

    if is_own_window() and has_a_reader():
        # A window opened by a double click closes at once, so a list of commands helps nobody.
        sys.argv += ["run", "--ask"]


def _keep_window_open_after_failure(
    _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
) -> None:
    if error is None or (isinstance(error, SystemExit) and not error.code):
        return
    from biosensor_gateway.system.windows_console import hold_open  # only now

    hold_open()


def _escape_unencodable_text() -> None:
    """Write characters that the output's encoding lacks as escapes, instead of failing."""
    typed: TextIO | None = sys.stdin
    if isinstance(typed, io.TextIOWrapper):
        # An undecodable answer is then refused by the prompt like any other wrong answer.
        typed.reconfigure(errors="replace")
    for stream in (sys.stdout, sys.stderr):
        # A windowed program on Windows has neither stream.
        if isinstance(stream, io.TextIOWrapper):
            # Windows encodes pipes with a code page of 256 characters.
            stream.reconfigure(errors="backslashreplace")
