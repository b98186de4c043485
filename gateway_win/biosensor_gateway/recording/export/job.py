"""Exports a recording: selects its parts, and writes each format to a temporary place first."""

from __future__ import annotations

import gc
import math
import os
import shutil
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import BATCH, Chosen, Selection, choose
from biosensor_gateway.recording.contents.contents import Contents, open_ended, with_rates
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.exporter import (
    FORMATS,
    GROWTH,
    HAVE_WIDE,
    NEED_RATES,
    USUAL_GROWTH,
    Clock,
    Exporter,
    ExportOptions,
    Missing,
    Progress,
    Times,
    with_reasons,
)
from biosensor_gateway.recording.export.outcome import NothingForIt, Outcome, Written
from biosensor_gateway.recording.export.readme import OF_ONE_FILE, readme_beside, write_readme
from biosensor_gateway.recording.participants import (
    Mismatch,
    Whose,
    compare_file,
    participant_of,
)
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.event_rules import pauses_told
from biosensor_gateway.recording.xdf.pace import stray_text
from biosensor_gateway.recording.xdf.recording import repeated_text
from biosensor_gateway.system.new_file import new_place

Watch = Callable[[str, float], Progress]
"""Takes a format and its number of seconds; returns its progress callback."""

_AS_RECORDED = ("csv", "csv-long", "mcap")
_SUFFIXES = (".gz", ".xdfz", ".xdf")


@dataclass(frozen=True, slots=True)
class Task:
    """Options of an export, as given by the user."""

    formats: Sequence[str]  # Names in `FORMATS`.
    selection: Selection
    _: KW_ONLY
    clock: Clock = Clock.LSL
    # An existing folder, or for a single format the file or folder itself; None for the recording's
    # folder.
    output: Path | None = None
    # task, session: task and session, for formats that contain them; empty to take them from the
    # file name.
    task: str = ""
    session: str = ""
    # Which participant is right, that of the file name or of the sensors; None if undecided.
    whose: Whose | None = None
    times: Times = Times.RECORDED
    batch: int = BATCH  # Number of values processed at once; results do not depend on it.
    is_wide: bool = False  # Whether `csv` should also contain a table per rate.
    # Rates in Hz of streams whose headers name none; by name or source_id, with `*` and `?`.
    rates: Mapping[str, float] = field(default_factory=dict[str, float])


def export(path: Path, task: Task, watch: Watch) -> Outcome:
    """Write a recording in each of the formats.

    A format without suitable data, such as Kubios without a heart signal, does not prevent the
    others.

    Raises
    ------
    ConfigError
        If a target exists, the selection is not in the recording, or it is still being recorded.
    RecordingError
        If the recording cannot be read, has no samples in the selection or no data for any format,
        or a target cannot be written. Targets that were complete by then stay.
    """
    with open_ended(path) as contents:
        recorded = {each.header.source_id: each.header.identity for each in contents.streams}
        participant = participant_of(path) if task.whose is Whose.NAME else ""
        for each in contents.streams if participant else ():
            each.take_wearer(participant)
        chosen = replace(choose(contents, task.selection), batch=task.batch)
        _require_samples(chosen)
        _require_clock(contents, task.clock)
        options = ExportOptions(
            task.clock,
            bare_name(path),
            task.task,
            task.session,
            participant,
            task.times,
            task.is_wide,
            notes := (*_clock_notes(chosen, task), *_event_notes(chosen, recorded)),
        )
        exporters = {name: FORMATS[name]() for name in dict.fromkeys(task.formats)}
        targets = _targets(path, task.output, options.name, exporters)
        _require_space(chosen, targets)
        try:
            with _no_search_for_cycles():
                written, without = _write_all(
                    chosen, options, exporters, targets, watch, task.rates
                )
        except RecordingError as error:
            if error.reason is not RecordingReason.EMPTY:
                raise
            # There is no outcome that would tell it.
            reasons = [each for each in notes if isinstance(each, Missing)]
            message = with_reasons(str(error), reasons) + contents.why_incomplete
            raise RecordingError(error.reason, message) from error
        return Outcome(
            path,
            tuple((s.header.name, s.header.source_id, s.sample_count) for s in chosen.streams),
            written,
            contents.damages,
            notes,
            without,
            _mismatch(path, chosen) if task.whose is None else None,
        )


def _mismatch(path: Path, chosen: Chosen) -> Mismatch | None:
    return compare_file(path, (each.header.identity for each in chosen.streams))


@contextmanager
def _no_search_for_cycles() -> Generator[None]:
    """Switch off Python's cyclic garbage collection."""
    # Exports create no cycles, but so many lists that the collection takes up to a tenth of the
    # time.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def bare_name(path: Path) -> str:
    """Return a recording's name without its suffix."""
    name = path.name
    for suffix in _SUFFIXES:
        if name.lower().endswith(suffix):
            name = name[: -len(suffix)]
    return name or path.name


def _require_samples(chosen: Chosen) -> None:
    if not any(True for each in chosen.streams for _ in chosen.samples(each)):
        path = chosen.contents.path
        why = chosen.contents.why_incomplete
        message = f"{path} has no samples in the selection, so nothing was written{why}"
        raise RecordingError(RecordingReason.EMPTY, message)


def _require_clock(contents: Contents, clock: Clock) -> None:
    if clock is Clock.WALL and contents.wall is None:
        message = f"{contents.path} does not contain the time of day; leave out --clock wall"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _clock_notes(chosen: Chosen, task: Task) -> Iterator[str]:
    wall, clock = chosen.contents.wall, task.clock
    if task.times is Times.EVEN:
        yield (
            "times of streams with a rate are on a straight line between two gaps; leave out "
            "--times even for the recorded ones"
        )
    if clock is Clock.WALL and wall is not None and wall.doubt:
        yield f"the time of day {wall.doubt}"
    if guessed := [each.header.title for each in chosen.streams if each.is_guessed]:
        yield (
            f"not all of {', '.join(guessed[:3])}{', ...' if len(guessed) > 3 else ''} is UTF-8, "
            "so characters were guessed from Windows' encoding"
        )
    if not_closed := chosen.contents.not_closed:
        yield not_closed
    unmeasured = [each.header.title for each in chosen.streams if not each.clock.is_known]
    if unmeasured:
        streams = "1 stream" if len(unmeasured) == 1 else f"{len(unmeasured)} streams"
        yield (
            f"the clock of {streams} was never measured ({', '.join(unmeasured[:3])}"
            f"{', ...' if len(unmeasured) > 3 else ''}): their timestamps are as recorded"
        )
    raw = " and ".join(name for name in task.formats if name in _AS_RECORDED)
    for each in chosen.streams:
        yield from _stream_notes(each, chosen.contents.begin_s, raw)


def _stream_notes(stream: Stream, zero_s: float, raw: str) -> Iterator[str]:
    """Yield notes about the samples of a stream, where `raw` names the formats as recorded."""
    title = stream.header.title
    if stream.untimed:
        samples = "1 sample is" if stream.untimed == 1 else f"{stream.untimed} samples are"
        yield Missing(f"{title}: {samples} left out, because their timestamps are not numbers")
    if stream.repeated:
        yield f"{title}: {repeated_text(stream.repeated)}"
    if stream.clock.unused:
        yield f"{title}: {stream.clock.unused}"
    for span in stream.clock.doubtful_spans:
        yield f"{title}: {span.text(zero_s)}"
    if stream.stray and raw:
        yield f"{title}: {stray_text(len(stream.stray))}, as recorded also in {raw}"
    if why := stream.clock_error or stream.part_error:
        yield Missing(f"{title}: {why}, so its time relative to the other streams is unknown")


def _event_notes(chosen: Chosen, recorded: Mapping[str, DeviceIdentity | None]) -> Iterator[str]:
    """Yield a note about each paused sensor, as its pauses are reported as missing samples.

    And about data of another agent, which may be another person's.

    Parameters
    ----------
    recorded
        By source_id, with the participants as events have them.
    """
    contents = chosen.contents
    found = (recorded.get(each.header.source_id) for each in chosen.streams)
    devices = tuple(dict.fromkeys(each for each in found if each is not None))
    for _, texts, ahead_s in contents.events:
        yield from pauses_told(texts, devices, contents.begin_s - ahead_s)
    yield from map(Missing, contents.of_other_agents)


def _targets(
    path: Path, output: Path | None, name: str, exporters: dict[str, Exporter]
) -> dict[str, Path]:
    folder = path.parent if output is None else output
    if output is not None and not output.is_dir():
        if len(exporters) > 1:
            message = (
                f"there is no folder {output}; create it first, because it is for several formats"
            )
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        ((format_name, exporter),) = exporters.items()
        suffix = exporter.suffix
        if suffix.startswith(".") and not output.name.endswith(suffix):
            message = f"{output} will be {format_name}; give it a name that ends in {suffix}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        targets = {format_name: output}
    else:
        targets = {key: folder / f"{name}{each.suffix}" for key, each in exporters.items()}
    if len(set(targets.values())) < len(targets):
        message = (
            f"{' and '.join(targets)} would have the same name; export them one after the other"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    told = [readme_beside(each) for key, each in targets.items() if key in OF_ONE_FILE]
    for target in (*targets.values(), *told):
        if target.is_symlink() or target.exists():
            raise _in_the_way(target)
    return targets


def _in_the_way(target: Path) -> ConfigError:
    message = f"{target} exists and is not overwritten; choose another place with --output"
    return ConfigError(ConfigReason.EXISTS, message)


def _require_space(chosen: Chosen, targets: dict[str, Path]) -> None:
    # For a part of the recording this is an overestimate, which is on the safe side.
    samples = sum(each.byte_count for each in chosen.streams)
    needed = samples * sum(GROWTH.get(name, USUAL_GROWTH) for name in targets)
    folder = next(iter(targets.values())).parent
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise _unwritable(folder, error) from error
    if free < needed:
        message = (
            f"the disk of {folder} has {free / 1e6:.1f} MB left, and this may take up to "
            f"{math.ceil(needed / 1e6)} MB; free some space, or choose another place with "
            "--output"
        )
        raise RecordingError(RecordingReason.UNWRITABLE, message)


def _write_all(
    chosen: Chosen,
    options: ExportOptions,
    exporters: dict[str, Exporter],
    targets: dict[str, Path],
    watch: Watch,
    rates: Mapping[str, float],
) -> tuple[tuple[Written, ...], tuple[NothingForIt, ...]]:
    rated: tuple[tuple[Stream, ...], list[str]] | None = None
    written: list[Written] = []
    without: list[NothingForIt] = []
    for name, exporter in exporters.items():
        wanted, notes = chosen, list[str]()
        if name in NEED_RATES or (options.is_wide and name in HAVE_WIDE):
            rated = rated or with_rates(chosen.streams, rates)
            wanted, notes = replace(chosen, streams=rated[0]), rated[1]
        try:
            written.append(_write(wanted, options, name, exporter, targets[name], watch, notes))
        except RecordingError as error:
            is_last_hope = not written and len(without) == len(exporters) - 1
            if error.reason is not RecordingReason.EMPTY or is_last_hope:
                raise
            without.append(NothingForIt(name, str(error)))
    return tuple(written), tuple(without)


def _write(
    chosen: Chosen,
    options: ExportOptions,
    name: str,
    exporter: Exporter,
    target: Path,
    watch: Watch,
    rates: Sequence[str],
) -> Written:
    contents, options = chosen.contents, replace(options, notes=(*options.notes, *rates))
    begin_s, end_s = max(chosen.begin_s, contents.begin_s), min(chosen.end_s, contents.end_s)
    try:
        with new_place(target, like=contents.path) as made:
            notes = exporter.write(chosen, options, made, watch(name, max(0.0, end_s - begin_s)))
        if means := OF_ONE_FILE.get(name):
            files = {each.number: [target.name] for each in chosen.streams}
            write_readme(readme_beside(target), chosen, options, means, files, notes)
    except OSError as error:
        # Only an existing target itself is the user's error, not an existing file inside it.
        if isinstance(error, FileExistsError) and os.path.lexists(target):
            raise _in_the_way(target) from None
        raise _unwritable(target, error) from error
    return Written(name, target, _size(target), (*rates, *notes))


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(each.stat().st_size for each in files if each.is_file())


def _unwritable(path: Path, error: OSError) -> RecordingError:
    message = cannot_write(path, error)
    return RecordingError(RecordingReason.UNWRITABLE, message)


Watching = Callable[[Path], AbstractContextManager[Watch]]
"""Takes a recording; its context provides the callback for the progress of its export."""


@dataclass(frozen=True, slots=True)
class Exported:
    """The result for one of several recordings."""

    recording: Path
    outcome: Outcome | None = None  # None if it was in the dataset before, or failed.
    error: str = ""  # Why nothing was written, as a sentence; empty on success.

    @property
    def is_certain(self) -> bool:
        """Whether everything is written, now or earlier, and whose data it is is certain."""
        return not self.error and (self.outcome is None or self.outcome.is_certain)


def export_several(
    recordings: Sequence[Path], task: Task, watching: Watching
) -> Iterator[Exported]:
    """Export recordings one by one; an error in one does not stop the others.

    With ``bids`` and an output folder they become one dataset, see :mod:`.bids.study`. This is a
    generator: it stops between two recordings if the caller stops iterating.

    Raises
    ------
    ConfigError
        If other formats would go into the same dataset, or its folder is something else.
    """
    study = None
    if task.output is not None and "bids" in task.formats:
        if len(task.formats) > 1:
            message = "a data set can only hold BIDS; export to the other formats separately"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        # Brings what writes a data set.
        from biosensor_gateway.recording.export.bids.study import Study  # noqa: PLC0415

        study = Study(task.output)
    for recording in recordings:

        def export_to(place: Path | None, recording: Path = recording) -> Outcome:
            with watching(recording) as watch:
                return export(recording, replace(task, output=place), watch)

        try:
            outcome = export_to(task.output) if study is None else study.add(recording, export_to)
        except (RecordingError, ConfigError) as error:
            yield Exported(recording, error=str(error))
        else:
            yield Exported(recording, outcome)


def recordings_in(places: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the recordings in a list of files and folders, and those left out.

    If a recording was salvaged, its salvaged version is used and the original left out.

    Raises
    ------
    ConfigError
        ``NOT_FOUND``, if a folder contains none.
    """
    found: list[Path] = []
    left_out: list[Path] = []
    for place in places:
        if not place.is_dir():
            found.append(place)
            continue
        inside = sorted(each for each in place.rglob("*") if is_recording(each))
        if not inside:
            raise ConfigError(ConfigReason.NOT_FOUND, f"there is no recording (.xdf) in {place}")
        names = {*inside}
        for each in inside:
            (left_out if _salvaged(each) in names else found).append(each)
    return list(dict.fromkeys(found)), left_out


def is_recording(path: Path) -> bool:
    """Whether a file has a recording's suffix."""
    name = path.name.lower()
    return name.endswith((".xdf", ".xdf.gz", ".xdfz")) and path.is_file()


def _salvaged(path: Path) -> Path:
    return path.with_name(f"{path.name.split('.xdf')[0]}_salvaged.xdf")
