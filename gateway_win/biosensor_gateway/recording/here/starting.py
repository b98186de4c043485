"""Begins a recording, and waits until all its streams are open."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.predicates import EVERYTHING
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file
from biosensor_gateway.recording.here.errors import RecorderError, RecorderReason
from biosensor_gateway.recording.here.results import StartedHere
from biosensor_gateway.recording.here.ways import Way, find_ways
from biosensor_gateway.recording.labrecorder.recording_file import size_of
from biosensor_gateway.recording.labrecorder.starting import (
    Order,
    recorded_without,
    require_participant,
    require_sensors,
    what_is_missing,
)
from biosensor_gateway.recording.recorder.program import Said, predicate
from biosensor_gateway.recording.recorder.request import MAX_RUN, SUFFIXES, Place, choose_target
from biosensor_gateway.recording.recorder.result import By
from biosensor_gateway.recording.recorder.state import Job, Kept, RecorderFolder
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream, titles
from biosensor_gateway.recording.recorder.supervisor import END_S, launch
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.system import state_file
from biosensor_gateway.system.cloud_folders import warnings_of

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
