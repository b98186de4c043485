"""The process that runs the program that records, and ends it when somebody asks.

The program records until a line comes in, or its input ends. A keeper of its own holds that
input, so that a recording goes on when the terminal or page that began it dies. If the keeper
itself is killed, the input ends with it, and the program closes its file.
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
from biosensor_gateway.recording.recorder.program import OWN, Said, library_folder
from biosensor_gateway.recording.recorder.state import Kept, RecorderFolder
from biosensor_gateway.system import windows_shutdown
from biosensor_gateway.system.ansi_path import ansi_folder
from biosensor_gateway.system.child import start_beside

KEEPER = "keep-recording"
"""First argument of the command line that is a keeper; the second is the state folder."""
END_S = 60.0
"""LabRecorder's waits up to five seconds for each of its threads."""
_GIVEN_UP_S = 5.0
"""For one whose file nobody wants."""
_POLL_S = 0.1
_ALREADY, _NOT_RUN = 3, 4


def launch(state: Path) -> None:
    """Start a keeper that outlives this process, for the job in the state folder.

    Raises
    ------
    OSError
        It cannot be started.
    """
    folder = RecorderFolder(state)
    with folder.keeper_log.open("wb") as log:
        start_beside([KEEPER, str(state)], output=log, cwd=folder.path)


def keep(state: Path) -> int:
    """Do the job in the state folder; return the exit code of this process."""
    folder = RecorderFolder(state)
    lock = folder.try_lock()
    if lock is None:
        return _ALREADY
    try:
        return _Keeper(folder).run()
    finally:
        lock.release()


class _Keeper:
    def __init__(self, folder: RecorderFolder) -> None:
        self._folder, self._is_told_to_end = folder, False

    def run(self) -> int:
        job = self._folder.job()
        kept = replace(job.kept, started=time.time())
        try:
            process = self._start(job.command, Path(kept.file))
        except OSError as error:
            problem = f"{job.command[0]} cannot be run ({error.strerror or error})"
            self._folder.keep(replace(kept, ended=time.time(), code=_NOT_RUN, problem=problem))
            return _NOT_RUN
        with process:
            self._folder.keep(kept := replace(kept, program=process.pid))
            while process.poll() is None and not self._is_to_end():
                time.sleep(_POLL_S)
            problem = "" if process.poll() is None else self._why_it_ended(process.returncode, kept)
            problem = self._end(process, kept) or problem
        self._folder.keep(
            replace(kept, ended=time.time(), code=process.returncode, problem=problem)
        )
        return 0

    def _start(self, command: tuple[str, ...], file: Path) -> subprocess.Popen[bytes]:
        # A service that ends tells all its processes, and only the keeper is to decide. What is
        # ignored stays so in the program that is started.
        for number in _requests():
            signal.signal(number, signal.SIG_IGN)
        with self._folder.said.open("wb") as said:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=said,
                stderr=subprocess.STDOUT,
                # On Windows a path that it is given loses letters, its folder does not.
                cwd=file.parent,
                env=_environment(self._folder.lsl_config),
                creationflags=NO_WINDOW,
                # Else a limit on the size of files would kill it.
                restore_signals=False,
            )
        for number in _requests():
            signal.signal(number, lambda _number, _frame: self._request_end())
        if sys.platform == "win32":
            # The recorder's program would be ended like any other, with its file open.
            windows_shutdown.watch(self._request_end, before_others=True)
        return process

    def _end(self, process: subprocess.Popen[bytes], kept: Kept) -> str:
        """Have the program close its file; return what went wrong."""
        limit_s = _GIVEN_UP_S if self._folder.is_given_up() else END_S
        send(process, b"\n")
        close_input(process)
        if wait_or_kill(process, limit_s):
            return f"{kept.recorder} did not end within {limit_s:g} s, and was killed"
        return ""

    def _why_it_ended(self, code: int, kept: Kept) -> str:
        said = Said(self._folder.what_was_said()).end if kept.recorder == OWN else ""
        return f"{kept.recorder} ended by itself: {said or ending_in_words(code)}"

    def _request_end(self) -> None:
        self._is_told_to_end = True

    def _is_to_end(self) -> bool:
        return self._is_told_to_end or self._folder.is_asked_to_stop()


def _environment(lsl_config: Path) -> Mapping[str, str]:
    # LabRecorder's program loses letters of a name that its code page lacks.
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
