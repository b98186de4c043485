"""The process that runs the recording program, and ends it on request.

The program records until it reads a line or its input ends. The supervisor holds that input, so a
recording continues when the terminal or page that started it ends. If the supervisor itself is
killed, the input ends and the program closes its file.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from biosensor_common.child import NO_WINDOW, close_input, ending_in_words, send, wait_or_kill
from biosensor_gateway.recording.recorder.program import (
    OWN,
    ProgramOutput,
    ansi_folder,
    library_folder,
)
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.system import windows_session
from biosensor_gateway.system.child import start_beside

SUPERVISE = "keep-recording"
"""First argument of a supervisor's command line; the second is the state folder."""
END_S = 60.0
"""LabRecorder's program waits up to five seconds for each of its threads."""
# Limit if the file is discarded anyway.
_GIVEN_UP_S = 5.0
_LARGEST_EXIT_CODE = 255
_POLL_S = 0.1
_ALREADY, _NOT_RUN = 3, 4


def launch(state: Path) -> None:
    """Start a supervisor that outlives this process, for the recording in the state folder.

    Raises
    ------
    OSError
        If it cannot be started.
    """
    folder = RecorderFolder(state)
    with folder.supervisor_log.open("wb") as log:
        start_beside([SUPERVISE, str(state)], output=log, cwd=folder.path)


def supervise(state: Path) -> int:
    """Make the recording requested in the state folder; return the exit code."""
    folder = RecorderFolder(state)
    lock = folder.try_lock()
    if lock is None:
        return _ALREADY
    try:
        return _Supervisor(folder).run()
    finally:
        lock.release()


class _Supervisor:
    def __init__(self, folder: RecorderFolder) -> None:
        self._folder, self._is_told_to_end = folder, False

    def run(self) -> int:
        recording = replace(self._folder.requested(), started=time.time())
        try:
            process = self._start(recording)
        except OSError as error:
            problem = f"{recording.command[0]} cannot be run ({error.strerror or error})"
            self._save_end(recording, _NOT_RUN, problem)
            return _NOT_RUN
        with process:
            self._folder.save(recording := replace(recording, program=process.pid))
            while process.poll() is None and not self._is_to_end():
                time.sleep(_POLL_S)
            problem = "" if process.poll() is None else self._why_it_ended(process, recording)
            problem = self._end(process, recording) or problem
        self._save_end(recording, process.returncode, problem)
        return 0

    def _save_end(self, recording: SavedRecording, code: int, problem: str) -> None:
        self._folder.save(replace(recording, ended=time.time(), code=code, problem=problem))

    def _start(self, recording: SavedRecording) -> subprocess.Popen[bytes]:
        # A service that stops signals all its processes, but only the supervisor should end the
        # program. Ignored signals stay ignored in the program that is started.
        for number in _requests():
            signal.signal(number, signal.SIG_IGN)
        with self._folder.output.open("wb") as output:
            process = subprocess.Popen(
                recording.command,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                # On Windows the program garbles letters of a path argument, but not of its working
                # folder.
                cwd=Path(recording.file).parent,
                env=_environment(self._folder.lsl_config),
                creationflags=NO_WINDOW,
                # Otherwise a limit on the size of files would kill it.
                restore_signals=False,
            )
        for number in _requests():
            signal.signal(number, lambda _number, _frame: self._request_end())
        if sys.platform == "win32":
            # Otherwise Windows ends the recording program like any other, with its file open.
            windows_session.watch(self._request_end, before_others=True)
        return process

    def _end(self, process: subprocess.Popen[bytes], recording: SavedRecording) -> str:
        """End the program, which closes its file; return what went wrong."""
        limit_s = _GIVEN_UP_S if self._folder.is_given_up else END_S
        send(process, b"\n")
        close_input(process)
        if wait_or_kill(process, limit_s):
            return f"{recording.recorder} did not end within {limit_s:g} s, and was killed"
        return ""

    def _why_it_ended(self, process: subprocess.Popen[bytes], recording: SavedRecording) -> str:
        code = process.returncode
        # Ours says why it ends, unless it is killed or crashes.
        has_said_why = recording.recorder == OWN and 0 <= code <= _LARGEST_EXIT_CODE
        why = ProgramOutput(self._folder.printed()).end if has_said_why else ending_in_words(code)
        return f"{recording.recorder} ended by itself: {why}"

    def _request_end(self) -> None:
        self._is_told_to_end = True

    def _is_to_end(self) -> bool:
        return self._is_told_to_end or self._folder.is_asked_to_stop


def _environment(lsl_config: Path) -> Mapping[str, str]:
    # LabRecorder's program garbles letters of a path that its code page lacks.
    folder = ansi_folder(lsl_config.parent) or lsl_config.parent
    environment = {**os.environ, "LSLAPICFG": str(folder / lsl_config.name)}
    libraries = library_folder()
    if libraries is not None:
        environment["PATH"] = os.pathsep.join((str(libraries), environment.get("PATH", "")))
    return environment


def _requests() -> list[signal.Signals]:
    if sys.platform == "win32":
        return [signal.SIGINT, signal.SIGBREAK]
    return [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
