"""Records on this computer without LabRecorder's window: starts, watches and ends a recording.

LabRecorder's program says nothing of the file, neither in what it prints nor in its exit code (0
on a full disk), so whether a recording is good is read from the file.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.predicates import EVERYTHING
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file
from biosensor_gateway.agent.absences import Absence, absences, names
from biosensor_gateway.agent.state import is_sending
from biosensor_gateway.recording.recorder.labrecorder import (
    Order,
    recorded_without,
    require_participant,
    require_sensors,
    what_is_missing,
)
from biosensor_gateway.recording.recorder.live_file import (
    Glance,
    Growth,
    size_of,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.program import (
    PROGRAM_NAME,
    RECORD_STREAMS,
    Said,
    Way,
    find_ways,
    predicate,
)
from biosensor_gateway.recording.recorder.request import MAX_RUN, SUFFIXES, Place, choose_target
from biosensor_gateway.recording.recorder.result import (
    By,
    NotClosedError,
    RecorderError,
    RecorderReason,
    StandingHere,
    StartedHere,
    StoppedHere,
)
from biosensor_gateway.recording.recorder.state import Job, Kept, RecorderFolder
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream, titles
from biosensor_gateway.recording.recorder.supervisor import END_S, launch
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.expectation import ExpectedStream
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import check
from biosensor_gateway.system import state_file
from biosensor_gateway.system.cloud_folders import warnings_of

Devices = Sequence[Mapping[str, Any]]
"""The devices of the agent, as its status has them; None in their place if no agent runs."""


def excused(devices: Devices | None, started: float) -> frozenset[str]:
    """Return the source_ids that may say nothing: switched off, or of a sensor known to be away.

    Parameters
    ----------
    started
        Unix time in s at which the recording began.
    """
    away = (each.sources for each in absences(devices or ()) if _is_known(each, started))
    silent = (
        source
        for device in devices or ()
        for source, stream in device["streams"].items()
        if stream["silent"]
    )
    return frozenset(silent).union(*away)


def findings(
    devices: Devices | None, recorded: Collection[str], started: float
) -> Iterator[Finding]:
    """Name the sensors of which nothing is recorded now.

    Parameters
    ----------
    recorded
        The source_ids that the file has; empty while nobody knows them.
    started
        Unix time in s at which the recording began.
    """
    if devices is None:
        text = "the agent does not run, so nothing of its sensors is recorded"
        yield Finding(Level.ERROR, "no-agent", "", text)
        return
    for each in absences(devices):
        level = Level.WARNING if _is_known(each, started) else Level.ERROR
        yield Finding(level, "away", "", each.sentence)
    for device, name in zip(devices, names(devices, "'s "), strict=True):
        sources = device["streams"].keys()
        sends = sources and is_sending(device["state"], paused=device["paused"])
        if sends and recorded and not sources & set(recorded):
            text = (
                f"{name} streams, and is not in the file: it was not there under this name when "
                "the recording began; stop it and record anew"
            )
            yield Finding(Level.ERROR, "left-out", "", text)


def _is_known(absence: Absence, started: float) -> bool:
    """Whether a person has wanted it: paused it, or begun to record without it."""
    was_before = absence.since is not None and absence.since <= started
    return absence.is_paused or absence.is_partial or was_before


_POLL_S = 0.1
WAY_S = 20.0
"""A program has so long to start, to look, and to open all streams; then the next one is tried."""
LAST_WAY_S = 60.0
"""For the last one, after which there is none to be tried."""
_KEEPER_S = 60.0
"""Until the program itself is started; on a busy computer that takes its time."""
_LEAST_FREE_BYTES = 10_000_000
_NO_STREAM_CODE = 2
_OF_THE_PROGRAM = frozenset({RecorderReason.NOT_BEGUN, RecorderReason.STREAMS_MISSING})
"""Reasons for which another program may do better."""


def begin(
    state: Path,
    order: Order,
    look: Callable[[], Presence],
    lsl: LslOverrides,
    *,
    counts_up: bool,
) -> StartedHere:
    """Begin a recording; see `Recording.start`."""
    folder = RecorderFolder(state)
    files = candidates(order.place, is_run_given=not counts_up)
    _require_idle(folder)
    begun, presence = time.monotonic(), look()
    ours = tuple(each for each in presence.visible if each not in presence.foreign)
    wanted = ours if order.only_ours else presence.visible
    require_sensors(presence, order)
    _require_streams(presence, wanted, order)
    require_participant(presence, order)
    file = take_file(files)
    with contextlib.ExitStack() as failed:
        failed.callback(_release, file)
        _require_space(file)
        what = predicate(wanted) if order.only_ours else EVERYTHING
        required = tuple(each.source_id for each in ours if each.source_id)
        kept = Kept(str(file), required, 0.0, without=tuple(sorted(presence.away_ids)))
        job = Job((file.name, what), kept)
        starter = _Starter(state, folder, job, lsl, order.growth_s)
        missed, remarks = starter.start(wanted, ours)
        failed.pop_all()
    recorded = tuple(each for each in wanted if each not in missed)
    foreign = tuple(each for each in recorded if each in presence.foreign)
    left_out = (*recorded_without(presence.missing), *_missed(missed))
    return StartedHere(
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
            *_foreign(order, foreign),
            *warnings_of(file.parent),
        ),
        left_out=left_out,
    )


class _Starter:
    """Starts the keeper until a program has found and opened all streams.

    LabRecorder's looks for one second, and of many it may miss some.
    """

    def __init__(
        self, state: Path, folder: RecorderFolder, job: Job, lsl: LslOverrides, growth_s: float
    ) -> None:
        self._state, self._folder, self._job = state, folder, job
        self._config = effective_config(user_config_file(os.environ, Path.home(), Path.cwd()), lsl)
        self._growth_s = growth_s

    def start(
        self, wanted: tuple[VisibleStream, ...], required: tuple[VisibleStream, ...]
    ) -> tuple[tuple[VisibleStream, ...], tuple[str, ...]]:
        """Return the wanted streams that are not recorded, none of the required, and remarks."""
        with contextlib.suppress(OSError):
            # That it cannot be made is said when a program is to be started.
            self._folder.path.mkdir(parents=True, exist_ok=True)
        left, tried = find_ways(self._folder.path)
        while True:
            way, *left = left
            try:
                missed = self._start_by(way, WAY_S if left else LAST_WAY_S, wanted, required)
            except RecorderError as error:
                if error.reason not in _OF_THE_PROGRAM:
                    raise
                tried.append(str(error))
                if not left:
                    raise RecorderError(error.reason, "; then: ".join(tried)) from error
            else:
                return missed, tuple(f"{each}. {way.title} records instead" for each in tried)

    def _start_by(
        self,
        way: Way,
        limit_s: float,
        wanted: tuple[VisibleStream, ...],
        required: tuple[VisibleStream, ...],
    ) -> tuple[VisibleStream, ...]:
        # Some tries, if streams are missed; each may take as long.
        until = time.monotonic() + min(WAY_S, self._growth_s)
        while True:
            self._launch(way)
            with contextlib.ExitStack() as failed:
                failed.callback(self._end)
                missed = self._wait(way, limit_s).missed(wanted)
                if missed and time.monotonic() < until:
                    continue
                _require_all_but_others(way, missed, wanted, required)
                failed.pop_all()
                return missed

    def _launch(self, way: Way) -> None:
        lock = None
        try:
            state_file.make_folder(self._folder.path)
            lock = self._folder.try_lock()
            if lock is None:
                raise _recording(self._folder)
            command = (*way.command, *self._job.command)
            job = Job(command, replace(self._job.kept, recorder=way.title))
            # Whoever watches it grow would read on in the middle of what the next program writes.
            Path(job.kept.file).open("wb").close()
            self._folder.give(job, self._config)
            lock.release()
            launch(self._state)
        except OSError as error:
            message = f"{self._folder.path} cannot be written ({error.strerror or error})"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from error
        finally:
            if lock is not None:
                lock.release()

    def _wait(self, way: Way, limit_s: float) -> Said:
        """Wait until all streams that were found are open."""
        deadline, has_begun = time.monotonic() + _KEEPER_S, False
        while True:
            kept, said = self._folder.kept(), Said(self._folder.what_was_said())
            if kept is not None and kept.ended:
                if kept.code == _NO_STREAM_CODE:
                    # It has missed all of them.
                    return said
                message = f"{kept.problem or 'the recording was ended'}; it had said: {said.end}"
                raise RecorderError(RecorderReason.NOT_BEGUN, message)
            if said.records:
                return said
            if kept is not None and not has_begun:
                deadline, has_begun = time.monotonic() + limit_s, True
            if time.monotonic() > deadline:
                message = (
                    f"{way.title} does not open all streams in time; it had said: "
                    f"{said.end if kept is not None else self._keeper_said()}"
                )
                raise RecorderError(RecorderReason.NOT_BEGUN, message)
            time.sleep(_POLL_S)

    def _keeper_said(self) -> str:
        try:
            return Said(self._folder.keeper_log.read_text("utf-8", "replace")).end
        except OSError:
            return "nothing"

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            self._folder.ask_to_stop(at_once=True)
        self._folder.wait_until_free(END_S)
        self._folder.forget()


def _require_all_but_others(
    way: Way,
    missed: tuple[VisibleStream, ...],
    wanted: tuple[VisibleStream, ...],
    required: tuple[VisibleStream, ...],
) -> None:
    """Refuse to record without a stream that is required, or without any."""
    if set(missed) & set(required) or (missed and len(missed) == len(wanted)):
        message = (
            f"{way.title} does not find {titles(missed)}; look for what is in the way with: "
            "biosensor-gateway doctor"
        )
        raise RecorderError(RecorderReason.STREAMS_MISSING, message)


def _require_idle(folder: RecorderFolder) -> None:
    if folder.is_kept():
        raise _recording(folder)


def _recording(folder: RecorderFolder) -> RecorderError:
    kept = folder.kept()
    where = f", to {kept.file}" if kept is not None else ""
    message = f"this computer is recording already{where}; end that with: record stop"
    return RecorderError(RecorderReason.RECORDING, message)


def _require_streams(presence: Presence, wanted: tuple[VisibleStream, ...], order: Order) -> None:
    message = what_is_missing(presence, wanted, order)
    if message is not None:
        raise RecorderError(RecorderReason.STREAMS_MISSING, message)


def _require_space(file: Path) -> None:
    free = shutil.disk_usage(file.parent).free
    if free < _LEAST_FREE_BYTES:
        message = f"the disk of {file.parent} is full ({free / 1e6:.1f} MB left); make room on it"
        raise RecorderError(RecorderReason.UNWRITABLE, message)


def _missed(streams: tuple[VisibleStream, ...]) -> Iterator[str]:
    if streams:
        yield f"these cannot be found or opened, and so are not recorded: {titles(streams)}"


def _foreign(order: Order, streams: tuple[VisibleStream, ...]) -> Iterator[str]:
    if streams and not order.all_streams:
        yield (
            "every stream is recorded, and these are not of this agent (--only-ours leaves them "
            f"out): {titles(streams)}"
        )


def _release(file: Path) -> None:
    """Give a name back to which nothing was recorded."""
    # A program that found streams, but not all, leaves headers behind, and perhaps samples.
    with contextlib.suppress(OSError, RecordingError):
        if not size_of(file) or not _has_samples(file):
            file.unlink()


def _has_samples(file: Path) -> bool:
    return any(stream.sample_count for stream in read_recording(file).streams)


def candidates(place: Place, *, is_run_given: bool) -> tuple[Path, ...]:
    """Return the files that will do, the first best.

    A BIDS name has its run and all after it, unless its run was asked for. In a folder without
    a name, the time is the name.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if `place` says too little or contradicts itself.
    """
    return tuple(_free_names(place, is_run_given=is_run_given))


def take_file(files: Sequence[Path]) -> Path:
    """Make the first file whose name is free, empty, so that nobody else takes it.

    Raises
    ------
    RecorderError
        ``EXISTS`` or ``UNWRITABLE``.
    """
    for file in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("xb").close()
        except FileExistsError:
            # Else a folder cannot be made, because a file has its name.
            if file.parent.is_dir():
                continue
            message = f"{file.parent} is no folder; choose another one"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from None
        except OSError as error:
            message = f"{file} cannot be written ({error.strerror or error}); choose another folder"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from error
        return file
    message = f"{files[0]} is there already; choose another name or run"
    raise RecorderError(RecorderReason.EXISTS, message)


def _free_names(place: Place, *, is_run_given: bool) -> Iterator[Path]:
    if place.recorder_folder:
        message = "--recorder-folder is for a LabRecorder on another computer; leave it out"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    target = choose_target(place, is_local=True)
    if target.folder is None:
        raise AssertionError("a place on this computer has a folder")
    if place.file is not None:
        # As it was written: only LabRecorder's window makes it lower-case.
        yield _speakable(target.files[-1])
    elif place.labels is None:
        yield target.folder / time.strftime("recording-%Y%m%d-%H%M%S.xdf")
    else:
        last = place.labels.run if is_run_given else MAX_RUN
        for run in range(place.labels.run, last + 1):
            yield target.folder / replace(place.labels, run=run).path


def _speakable(file: Path) -> Path:
    if file.suffix.lower() != SUFFIXES[0]:
        message = f"--file {file}: the name must end in .xdf"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    # It is run in the file's folder, so that only the name must be of such letters.
    if sys.platform == "win32" and not file.name.isascii():
        message = (
            f"--file {file.name}: on Windows LabRecorder's program takes names of English letters "
            "only; the folder may have any"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return file


_MARGIN_S = 10.0
_STILL_S = 0.5
"""The program has ended, so nothing is written any more."""
_CLOSING_S = 30.0


class Recording:
    """The one recording that this computer makes by itself for a state folder.

    It belongs to no process: whoever has the state folder can look at it and end it. Each
    object reads the file on from where it was when it looked last, so keep one to watch.

    Parameters
    ----------
    state
        The state folder.
    """

    def __init__(self, state: Path) -> None:
        self._state = state.absolute()
        self._folder = RecorderFolder(self._state)
        self._growth: tuple[Path, float, Growth] | None = None

    @property
    def is_running(self) -> bool:
        """Whether it records."""
        return self._folder.is_kept()

    @property
    def file(self) -> Path | None:
        """Where it records to, or did when it died; None if there is none, or it was ended."""
        kept = self._folder.kept()
        return None if kept is None else Path(kept.file)

    @property
    def file_going_on(self) -> Path | None:
        """Where it records to; None if it does not."""
        return self.file if self.is_running else None

    def start(
        self,
        order: Order,
        look: Callable[[], Presence],
        lsl: LslOverrides | None = None,
        *,
        counts_up: bool = True,
    ) -> StartedHere:
        """Begin to record; all streams are open when this returns.

        Parameters
        ----------
        order
            What to record. Streams of others are recorded, too, unless it says `only_ours`;
            `growth_s` is how long it may take to open all.
        look
            Looks for the streams there are.
        lsl
            What our settings say of LSL.
        counts_up
            Whether a BIDS name whose run is taken gets the next one.

        Raises
        ------
        RecorderError
            With the reason why nothing is recorded.
        ConfigError
            If `order` makes no sense.
        """
        return begin(self._state, order, look, lsl or LslOverrides(), counts_up=counts_up)

    def stop(self) -> StoppedHere:
        """End it, see the file closed, and judge it. Takes some seconds.

        Raises
        ------
        RecorderError
            ``NOT_RECORDING``, or ``NOT_CLOSED`` with what is known of why.
        """
        return end(self._folder)

    def standing(self, devices: Devices | None = ()) -> StandingHere | None:
        """Look at it; None if there is none, or it was ended.

        Parameters
        ----------
        devices
            What the agent says of its devices; None if no agent runs.
        """
        is_running, kept = self._folder.is_kept(), self._folder.kept()
        if kept is None:
            return None
        growth = self._growth_of(Path(kept.file), kept.started)
        problem = "" if is_running else kept.problem or self._why_it_ended(kept.ended)
        findings = [Finding(Level.ERROR, "ended", "", problem)] if problem else []
        try:
            sight = growth.look()
        except OSError as error:
            sight = None
            text = f"{kept.file} cannot be read ({error.strerror or error})"
            findings.append(Finding(Level.ERROR, "unreadable", "", text))
        streams = () if sight is None else sight.streams
        if is_running:
            recorded = {each.source_id for each in streams}
            # Streams of other programs are recorded without an agent, too.
            if devices is not None or kept.required:
                findings += findings(devices, recorded, kept.started)
            silent = excused(devices, kept.started)
            findings += [*growth.problems(kept.required, silent), *growth.gaps()]
            findings.sort(key=lambda each: list(Level).index(each.level))
        return StandingHere(
            by=By.GATEWAY,
            recording=is_running,
            file=Path(kept.file),
            started=kept.started,
            bytes=0 if sight is None else sight.bytes,
            streams=len(streams),
            with_samples=sum(each.samples > 0 for each in streams),
            is_closed=sight is not None and sight.is_closed,
            required=kept.required,
            sight=sight,
            problems=tuple(findings),
        )

    def _growth_of(self, file: Path, started: float) -> Growth:
        if self._growth is None or self._growth[:2] != (file, started):
            self._growth = (file, started, Growth(file))
        return self._growth[2]

    def _why_it_ended(self, ended: float) -> str:
        """Say why nobody keeps it any more; nothing while who has ended it looks at its file."""
        if ended and self._folder.is_asked_to_stop():
            return ""
        if ended:
            # As its service did, or the computer.
            return "the recording was ended from outside; see its verdict: record stop"
        return "the recording's keeper was killed, and the recording ended with it"


def not_recording() -> RecorderError:
    """Return what is said where there is nothing to end or to look at."""
    message = "nothing is being recorded here; begin with: biosensor-gateway record start"
    return RecorderError(RecorderReason.NOT_RECORDING, message)


def end(folder: RecorderFolder) -> StoppedHere:
    """End a recording; see `Recording.stop`."""
    begun = time.monotonic()
    if folder.is_kept():
        _ask(folder)
    kept = folder.kept()
    if kept is None:
        raise not_recording()
    file = Path(kept.file)
    if not kept.ended:
        _wait_for_program(kept)
    seen = wait_until_closed(file, _STILL_S, _CLOSING_S)
    folder.forget()
    said = Said(folder.what_was_said())
    expected = [ExpectedStream(each, each) for each in kept.required]
    if seen is None:
        message = f"{kept.file} still grows, though nobody keeps it; record stop --file looks again"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)
    if not seen.is_closed:
        verdict = None
        with contextlib.suppress(RecordingError):
            verdict = check(file, expected, kept.without, said.notes)
        why = _why_not_closed(kept, seen)
        message = (
            f"{kept.file}: {why}. Look at it with: biosensor-gateway xdf check. The last that "
            f"{kept.recorder} said: {said.end}"
        )
        raise NotClosedError(message, why, verdict)
    took_s = time.monotonic() - begun
    return StoppedHere(
        by=By.GATEWAY,
        verified=True,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        took_s=took_s,
        verdict=check(file, expected, kept.without, said.notes),
        warnings=tuple(_warnings(kept)),
    )


def _ask(folder: RecorderFolder) -> None:
    try:
        folder.ask_to_stop()
    except OSError as error:
        message = (
            f"the recording cannot be told to end: {folder.path} cannot be written "
            f"({error.strerror or error})"
        )
        raise RecorderError(RecorderReason.UNWRITABLE, message) from error
    limit_s = END_S + _MARGIN_S
    if not folder.wait_until_free(limit_s):
        message = f"the recording did not end within {limit_s:g} s; look at it with: record status"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)


def _wait_for_program(kept: Kept) -> None:
    """Wait while the program closes its file, whose keeper was killed."""
    with contextlib.suppress(psutil.Error):
        program = psutil.Process(kept.program)
        # Some other may have its number by now.
        if program.name().startswith(PROGRAM_NAME) or RECORD_STREAMS in program.cmdline():
            program.wait(END_S)


def _why_not_closed(kept: Kept, seen: Glance) -> str:
    what = (
        "it is empty" if not seen.bytes else "it was not closed: it breaks off, or its disk is full"
    )
    return f"{kept.problem}; {what}" if kept.problem else what


def _warnings(kept: Kept) -> list[str]:
    if kept.problem:
        return [kept.problem]
    return [] if kept.ended else ["the recording's keeper was killed, so it had ended before"]
