"""Starts, monitors and stops a recording on this computer, without LabRecorder's window.

LabRecorder's program reports no file errors, neither in its output nor in its exit code (0 on a
full disk), so a recording is checked by reading its file.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import psutil

from biosensor_common.lsl.api_file import (
    LOOPBACK,
    PEERS,
    LslOverrides,
    changed,
    config_here,
    known_peers,
)
from biosensor_common.lsl.predicates import EVERYTHING
from biosensor_gateway.agent.device_states import clock_time
from biosensor_gateway.recording.recorder.live_file import GONE, Growth
from biosensor_gateway.recording.recorder.presence import (
    Devices,
    away_findings,
    doubles,
    excused,
    live_features,
    look,
    own_events,
    recorded_without,
    require_startable,
    titles,
)
from biosensor_gateway.recording.recorder.programs import (
    END_S,
    PROGRAM_NAME,
    RECORD_STREAMS,
    ProgramOutput,
    find_programs,
    launch,
    predicate,
)
from biosensor_gateway.recording.recorder.recording_file import (
    FileSummary,
    size_of,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.request import (
    By,
    LocalStarted,
    LocalStatus,
    LocalStopped,
    NotClosedError,
    RecorderError,
    RecorderReason,
    RecordingRequest,
    VisibleStream,
    local_files,
)
from biosensor_gateway.recording.recorder.state import LAB_RECORDER, RecorderFolder, SavedRecording
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.event_rules import clock_set_text
from biosensor_gateway.recording.xdf.findings import Finding, Level, late_streams, unreported
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import ExpectedStream, Verdict, check
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import warnings_of
from biosensor_gateway.system import state_file

PROGRAM_S = 20.0
"""Time for a program to start, search and open all streams, before the next one is tried."""
LAST_PROGRAM_S = 60.0
"""Time for the last program, after which there is none left to try."""
# Time until the program is started, which takes long on a busy computer.
_SUPERVISOR_S = 60.0
_POLL_S = 0.1
_MARGIN_S = 10.0
# How long a file must be unchanged; short, because the program has ended.
_STILL_S = 0.5
_CLOSING_S = 30.0
_LEAST_FREE_BYTES = 10_000_000
# How long LSL keeps samples for LabRecorder's program.
_KEPT_S = 360.0
_NO_STREAM_CODE = 2
# Errors after which another program may succeed.
_OF_THE_PROGRAM = frozenset({RecorderReason.NOT_BEGUN, RecorderReason.STREAMS_MISSING})

_MOST_MISSED = 3
"""Limit of streams that are named where a program misses most of them."""


class LocalRecorder:
    """Recorder on this computer, which makes one recording at a time per state folder.

    The recording does not belong to a process: any process with the state folder can query and
    stop it. An object reads the file incrementally, so keep one for repeated queries.
    """

    def __init__(self, state: Path) -> None:
        self._state = state.absolute()
        self._folder = RecorderFolder(self._state)
        self._growth: tuple[Path, float, Growth] | None = None
        self._seen: SavedRecording | None = None

    @property
    def is_running(self) -> bool:
        """Whether it is recording."""
        return self._folder.is_running

    @property
    def file(self) -> Path | None:
        """The file being recorded, or being recorded at a crash; None if none or stopped."""
        saved = self._folder.saved()
        return None if saved is None else Path(saved.file)

    @property
    def file_going_on(self) -> Path | None:
        """The file being recorded; None if it is not recording."""
        return self.file if self.is_running else None

    def start(self, request: RecordingRequest, settings: GatewaySettings) -> LocalStarted:
        """Start a recording and wait until all streams are open.

        Raises
        ------
        RecorderError
            If nothing is recorded; see its reason.
        ConfigError
            If `request` is invalid.
        """
        files = local_files(request)
        if self._folder.is_running:
            raise _recording(self._folder)
        begun, presence = time.monotonic(), look(settings, self._state)
        ours = tuple(each for each in presence.visible if each not in presence.foreign)
        wanted = ours if request.only_ours else presence.visible
        require_startable(presence, wanted, request)
        file = take_file(files)
        with contextlib.ExitStack() as failed:
            failed.callback(_release, file)
            _require_space(file)
            recording = SavedRecording(
                str(file),
                tuple(each.source_id for each in ours if each.source_id),
                started=0.0,
                without=tuple(sorted(presence.away_ids)),
                visible=None if request.only_ours else presence.visible,
                command=(file.name, predicate(wanted) if request.only_ours else EVERYTHING),
            )
            starter = _Starter(self._state, recording, settings.lsl.overrides, request.growth_s)
            missed, remarks = starter.start(wanted, ours)
            failed.pop_all()
        recorded = tuple(each for each in wanted if each not in missed)
        foreign = tuple(each for each in recorded if each in presence.foreign)
        left_out = (
            *recorded_without(presence.missing),
            *_missed(missed),
            *doubles(presence, wanted),
        )
        return LocalStarted(
            by=By.GATEWAY,
            verified=True,
            file=file,
            bytes=size_of(file) or 0,
            took_s=time.monotonic() - begun,
            streams=recorded,
            foreign=foreign,
            warnings=(
                *remarks,
                *recorded_without(presence.away),
                *left_out,
                *_others(request, recorded, foreign),
                *warnings_of(file.parent),
            ),
            left_out=left_out,
        )

    def status(
        self, devices: Devices | None = (), agent_started_s: float | None = None
    ) -> LocalStatus | None:
        """Return the status of the recording; None if there is none or it was stopped.

        Parameters
        ----------
        devices
            The agent's status of its devices; None if no agent runs.
        agent_started_s
            When this agent began, in LSL s, by its status; None if unknown.
        """
        is_running, saved = self._folder.is_running, self._folder.saved()
        if saved is None:
            return None
        self._seen = saved
        growth = self._growth_of(saved)
        problem = "" if is_running else saved.problem or self._why_it_ended(saved.ended)
        findings = [Finding(Level.ERROR, "ended", "", problem)] if problem else []
        try:
            progress = growth.look()
        except OSError as error:
            progress = None
            text = f"{saved.file} cannot be read ({error.strerror or error})"
            findings.append(Finding(Level.ERROR, "unreadable", "", text))
        streams = () if progress is None else progress.streams
        if is_running:
            recorded = {each.source_id for each in streams}
            # Other programs' streams can be recorded without an agent.
            if devices is not None or saved.required:
                findings += away_findings(devices, recorded, saved.started, saved.without)
            # That an agent is away says that of all its streams.
            is_away = devices is None
            silent = growth.sources_of_agent(own_events()) if is_away else excused(devices)
            findings += growth.problems(saved.required, silent)
            findings += growth.story(own_events(), agent_started_s)
            findings += late_streams(saved.late, {(e.name, e.source_id) for e in streams})
            findings += unreported(_clock_set(saved), growth.clock_steps_s)
            findings.sort(key=lambda each: list(Level).index(each.level))
        return LocalStatus(
            by=By.GATEWAY,
            recording=is_running,
            file=Path(saved.file),
            started=saved.started,
            elapsed_s=time.time() - saved.began,
            bytes=0 if progress is None else progress.bytes,
            streams=len(streams),
            with_samples=sum(each.samples > 0 for each in streams),
            is_closed=progress is not None and progress.is_closed,
            required=saved.required,
            sight=progress,
            problems=tuple(findings),
        )

    def stopped_elsewhere(self) -> Verdict | None:
        """Check, once, the recording of the last `status` that another process has stopped since.

        Raises
        ------
        RecordingError
            If its file cannot be read, as after it was discarded.
        """
        seen = self._seen
        if seen is None or self._folder.saved() is not None:
            return None
        self._seen = None
        return self._check(seen)

    def _check(self, saved: SavedRecording) -> Verdict:
        expected = [ExpectedStream(each, each) for each in saved.required]
        notes = ProgramOutput(self._folder.printed()).notes
        steps = tuple(_clock_set(saved))
        return check(Path(saved.file), expected, saved.without, notes, saved.late, steps)

    def stop(self) -> LocalStopped:
        """Stop the recording, wait until its file is closed, and check it; takes some seconds.

        Raises
        ------
        RecorderError
            ``NOT_RECORDING``, or ``NOT_CLOSED`` with the reason, if known.
        """
        begun = time.monotonic()
        if self._folder.is_running:
            _ask_to_stop(self._folder)
        saved = self._folder.saved()
        if saved is None:
            raise not_recording()
        file = Path(saved.file)
        if not saved.ended:
            _wait_for_program(saved)
        seen = wait_until_closed(file, _STILL_S, _CLOSING_S)
        self._folder.forget()
        self._seen = None
        if seen is None:
            message = (
                f"{file} is still growing, although its recorder has ended; record stop --file "
                "checks it again"
            )
            raise RecorderError(RecorderReason.NOT_CLOSED, message)
        if not seen.is_closed:
            verdict = None
            with contextlib.suppress(RecordingError):
                verdict = self._check(saved)
            why = _why_not_closed(saved, seen)
            message = (
                f"{file}: {why}. Check it with: biosensor-gateway xdf check. The last output of "
                f"{saved.recorder}: {ProgramOutput(self._folder.printed()).end}"
            )
            raise NotClosedError(message, why, verdict)
        took_s = time.monotonic() - begun
        return LocalStopped(
            by=By.GATEWAY,
            verified=True,
            file=file,
            bytes=seen.bytes,
            streams=len(seen.streams),
            with_samples=len(seen.with_samples),
            took_s=took_s,
            verdict=self._check(saved),
            warnings=tuple(_warnings(saved)),
        )

    def _growth_of(self, saved: SavedRecording) -> Growth:
        file = Path(saved.file)
        if self._growth is None or self._growth[:2] != (file, saved.started):
            self._growth = (file, saved.started, Growth(file, began=saved.began))
        return self._growth[2]

    def _why_it_ended(self, ended: float) -> str:
        """Return why its supervisor has ended; empty while a stop request checks the file."""
        if ended and self._folder.is_asked_to_stop:
            return ""
        if ended:
            # By its service, or by the shutdown of the computer.
            return "the recording was ended from outside this program; see its verdict: record stop"
        return "the recording's supervisor was killed, and the recording ended with it"


def _asking_itself(config: str) -> str:
    """Return an LSL configuration that also searches this computer directly.

    Without a network, or if LSL keeps to this computer, LabRecorder's program (liblsl 1.17) finds
    by multicast one stream of many.
    """
    peers = known_peers(config)
    if LOOPBACK in peers:
        return config
    return changed(config, {PEERS: "{" + ", ".join([LOOPBACK, *peers]) + "}"})


class _Starter:
    """Starts supervisors until a program has found and opened all streams.

    LabRecorder's program searches for one second only and may miss some of many streams.
    """

    def __init__(
        self, state: Path, recording: SavedRecording, lsl: LslOverrides, growth_s: float
    ) -> None:
        self._state, self._recording, self._growth_s = state, recording, growth_s
        self._folder = RecorderFolder(state)
        self._config = _asking_itself(config_here(lsl))

    def start(
        self, wanted: tuple[VisibleStream, ...], required: tuple[VisibleStream, ...]
    ) -> tuple[tuple[VisibleStream, ...], tuple[str, ...]]:
        """Return the wanted but not required streams that are not recorded, and remarks."""
        with contextlib.suppress(OSError):
            # A failure is reported when the program is started.
            state_file.make_folder(self._folder.path)
        programs, tried = find_programs(self._folder.path)
        left = [*programs]
        while True:
            title, *left = left
            recording = replace(
                self._recording,
                recorder=title,
                command=(*programs[title], *self._recording.command),
            )
            limit_s = PROGRAM_S if left else LAST_PROGRAM_S
            try:
                missed = self._start_program(recording, limit_s, wanted, required)
            except RecorderError as error:
                if error.reason not in _OF_THE_PROGRAM:
                    raise
                tried.append(str(error))
                if not left:
                    raise RecorderError(error.reason, "; then: ".join(tried)) from error
            else:
                title = f"{title[0].upper()}{title[1:]}"
                return missed, tuple(f"{each}. {title} records instead" for each in tried)

    def _start_program(
        self,
        recording: SavedRecording,
        limit_s: float,
        wanted: tuple[VisibleStream, ...],
        required: tuple[VisibleStream, ...],
    ) -> tuple[VisibleStream, ...]:
        # Several attempts if streams are missed; each may take as long.
        until = time.monotonic() + min(PROGRAM_S, self._growth_s)
        while True:
            self._hand_over(recording)
            with contextlib.ExitStack() as failed:
                # Before the start: after an interrupt a supervisor would go on, unknown to anybody.
                failed.callback(self._give_up)
                self._launch()
                missed = self._wait(recording.recorder, limit_s).missed(wanted)
                if missed and time.monotonic() < until:
                    continue
                if set(missed) & set(required) or (missed and len(missed) == len(wanted)):
                    message = (
                        f"{recording.recorder} does not find {titles(missed, _MOST_MISSED)}; "
                        "find out why with: biosensor-gateway doctor"
                    )
                    raise RecorderError(RecorderReason.STREAMS_MISSING, message)
                failed.pop_all()
                return missed

    def _hand_over(self, recording: SavedRecording) -> None:
        """Request the recording from the supervisor that is started next."""
        lock = None
        try:
            state_file.make_folder(self._folder.path)
            lock = self._folder.try_lock()
            if lock is None:
                raise _recording(self._folder)
            # Emptied, because readers of the growing file must not continue in the next program's
            # output.
            Path(recording.file).open("wb").close()
            self._folder.hand_over(recording, self._config)
        except OSError as error:
            raise self._unwritable(error) from error
        finally:
            if lock is not None:
                lock.release()

    def _launch(self) -> None:
        try:
            launch(self._state)
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> RecorderError:
        message = f"{self._folder.path} cannot be written ({error.strerror or error})"
        return RecorderError(RecorderReason.UNWRITABLE, message)

    def _wait(self, title: str, limit_s: float) -> ProgramOutput:
        """Wait until all streams found are open."""
        deadline, has_begun = time.monotonic() + _SUPERVISOR_S, False
        while True:
            saved, output = self._folder.saved(), ProgramOutput(self._folder.printed())
            if saved is not None and saved.ended:
                if saved.code == _NO_STREAM_CODE:
                    # It found no streams.
                    return output
                why = saved.problem or "the recording was ended"
                message = f"{why}; its last output was: {output.end}"
                raise RecorderError(RecorderReason.NOT_BEGUN, message)
            if output.records:
                return output
            if saved is not None and not has_begun:
                deadline, has_begun = time.monotonic() + limit_s, True
            if time.monotonic() > deadline:
                message = (
                    f"{title} does not open all streams in time; its last output was: "
                    f"{output.end if saved is not None else self._end_of_log()}"
                )
                raise RecorderError(RecorderReason.NOT_BEGUN, message)
            time.sleep(_POLL_S)

    def _end_of_log(self) -> str:
        try:
            return ProgramOutput(self._folder.supervisor_log.read_text("utf-8", "replace")).end
        except OSError:
            return "nothing"

    def _give_up(self) -> None:
        with contextlib.suppress(OSError):
            self._folder.ask_to_stop(at_once=True)
        self._folder.wait_until_free(END_S)
        self._folder.forget()


def not_recording() -> RecorderError:
    """Return the error for a missing recording."""
    message = "nothing is being recorded here; start with: biosensor-gateway record start"
    return RecorderError(RecorderReason.NOT_RECORDING, message)


def _recording(folder: RecorderFolder) -> RecorderError:
    saved = folder.saved()
    where = f", to {saved.file}" if saved is not None else ""
    message = f"this computer is already recording{where}; end that with: record stop"
    return RecorderError(RecorderReason.RECORDING, message)


def take_file(files: Iterator[Path]) -> Path:
    """Create the first file that does not exist, empty, to reserve its name.

    Raises
    ------
    RecorderError
        ``EXISTS`` or ``UNWRITABLE``.
    """
    first = None
    for file in files:
        first = first or file
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("xb").close()
        except FileExistsError:
            # Otherwise a file has the name of a folder.
            if file.parent.is_dir():
                continue
            message = f"{file.parent} is not a folder; choose another one"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from None
        except OSError as error:
            message = f"{file} cannot be written ({error.strerror or error}); choose another folder"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from error
        return file
    message = f"{first} already exists; choose another name or run"
    raise RecorderError(RecorderReason.EXISTS, message)


def _require_space(file: Path) -> None:
    free = shutil.disk_usage(file.parent).free
    if free < _LEAST_FREE_BYTES:
        message = (
            f"the disk of {file.parent} is full ({free / 1e6:.1f} MB left); free some space on it"
        )
        raise RecorderError(RecorderReason.UNWRITABLE, message)


def _release(file: Path) -> None:
    """Delete a reserved file to which nothing was recorded."""
    # A program that did not find all streams leaves headers behind, and perhaps samples.
    with contextlib.suppress(OSError, RecordingError):
        if not size_of(file) or not any(each.sample_count for each in read_recording(file).streams):
            file.unlink()


def _missed(streams: Sequence[VisibleStream]) -> Iterator[str]:
    if streams:
        yield (
            f"these streams cannot be found or opened, so they are not recorded: {titles(streams)}"
        )


def _others(
    request: RecordingRequest,
    recorded: Sequence[VisibleStream],
    foreign: Sequence[VisibleStream],
) -> Iterator[str]:
    features = live_features(recorded, foreign)
    others = [each for each in foreign if each not in features]
    if others and not request.all_streams:
        yield (
            "streams of other programs are also recorded (--only-ours leaves them out): "
            f"{titles(others)}"
        )


def _ask_to_stop(folder: RecorderFolder) -> None:
    try:
        folder.ask_to_stop()
    except OSError as error:
        message = (
            f"the recording cannot be asked to end: {folder.path} cannot be written "
            f"({error.strerror or error})"
        )
        raise RecorderError(RecorderReason.UNWRITABLE, message) from error
    limit_s = END_S + _MARGIN_S
    if not folder.wait_until_free(limit_s):
        message = f"the recording did not end within {limit_s:g} s; look at it with: record status"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)


def _wait_for_program(saved: SavedRecording) -> None:
    """Wait until a program whose supervisor was killed has closed its file."""
    with contextlib.suppress(psutil.Error):
        program = psutil.Process(saved.program)
        # Another process may have its id by now.
        if program.name().startswith(PROGRAM_NAME) or RECORD_STREAMS in program.cmdline():
            program.wait(END_S)


def _clock_set(saved: SavedRecording) -> Iterator[tuple[float, Finding]]:
    """Report that this computer slept while it recorded, or that its clock was set, by how much."""
    # The program sleeps until times of day; on other systems its library takes another clock.
    can_wait = saved.recorder == LAB_RECORDER and sys.platform == "linux" and not saved.ended
    for each in saved.clock_steps:
        level, until = Level.WARNING, each.at - each.by_s
        text = f"this computer: before {_at(each.at)} {clock_set_text(each.by_s)}"
        if can_wait and until > time.time():
            level, text = Level.ERROR, f"{text}; {LAB_RECORDER} writes nothing until {_at(until)}: "
            text += "stop it only then" if -each.by_s < _KEPT_S else "stop, and record again"
        yield each.by_s, Finding(level, "clock-set", "", text)


def _at(unix_s: float) -> str:
    return clock_time(unix_s, seconds=True)


def _why_not_closed(saved: SavedRecording, seen: FileSummary) -> str:
    what = "it was not closed: it breaks off, or its disk is full"
    if not seen.bytes:
        what = "it is empty" if Path(saved.file).exists() else f"it {GONE}"
    return f"{saved.problem}; {what}" if saved.problem else what


def _warnings(saved: SavedRecording) -> list[str]:
    if saved.problem:
        return [saved.problem]
    return (
        []
        if saved.ended
        else ["the recording had already ended, because its supervisor was killed"]
    )
