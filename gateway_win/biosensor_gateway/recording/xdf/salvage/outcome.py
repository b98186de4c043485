"""Salvages a recording, and says what was kept and what is lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.xdf.container import (
    Damage,
    RecordingError,
    RecordingReason,
    open_recording,
)
from biosensor_gateway.recording.xdf.measuring import clock_error
from biosensor_gateway.recording.xdf.salvage.kept import Break, KeptStream
from biosensor_gateway.recording.xdf.salvage.rewriting import write_salvaged
from biosensor_gateway.recording.xdf.salvage.survey import Survey, survey

SUFFIX = ".xdf"
_ADDED = "_salvaged"
_PACKED_SUFFIXES = frozenset({".gz", ".xdfz"})


@dataclass(frozen=True, slots=True)
class Place:
    """A damage, and when it was, in s since the recording's begin; NaN where that is unknown."""

    damage: Damage
    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a recording.

    Attributes
    ----------
    written
        The new file; None if the recording is whole.
    closed
        Numbers of the streams that got a footer.
    """

    path: Path
    written: Path | None
    survey: Survey
    places: tuple[Place, ...]
    closed: tuple[int, ...]

    @property
    def lost_bytes(self) -> int:
        """Bytes of the recording that are not in the new file, footers left aside."""
        orphans = sum(each.bytes for each in self.survey.orphans.values())
        return orphans + sum(each.damage.end - each.damage.start for each in self.places)


def salvaged_path(path: Path) -> Path:
    """Return where a salvaged recording goes if nobody says otherwise: beside the original."""
    bare = path
    for suffixes in (_PACKED_SUFFIXES, {SUFFIX}):
        if bare.suffix.lower() in suffixes:
            bare = bare.with_suffix("")
    return bare.with_name(f"{bare.name}{_ADDED}{SUFFIX}")


def salvage(path: Path, target: Path) -> Outcome:
    """Write what can be read of a recording to another file, if the recording is not whole.

    Raises
    ------
    ConfigError
        If something is at `target` already, or it has a wrong suffix.
    RecordingError
        If `path` cannot be read, holds no sample, or the other file cannot be written.
    """
    if target.suffix.lower() != SUFFIX:
        message = f"{target} will be no compressed file; give it a name that ends in {SUFFIX}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    with open_recording(path) as opened:
        known = survey(path, opened)
        outcome = Outcome(path, None, known, _places(known), tuple(known.footers_due()))
        if known.is_whole:
            return outcome
        if not known.sample_count:
            message = f"{path} holds no sample that can be read, so nothing was written"
            raise RecordingError(RecordingReason.EMPTY, message)
        _refuse_to_overwrite(target)
        write_salvaged(opened.file, known, target, path)
    return Outcome(path, target, known, outcome.places, outcome.closed)


def _refuse_to_overwrite(target: Path) -> None:
    if target.is_symlink() or target.exists():
        message = f"{target} exists and is not overwritten; give another name with --output"
        raise ConfigError(ConfigReason.EXISTS, message)


def _places(known: Survey) -> tuple[Place, ...]:
    streams = [each for each in known.streams.values() if _is_on_lsl_clock(each)]
    begin = min((each.first + each.offset_s for each in streams), default=math.nan)
    return tuple(
        _place(damage, number, streams, begin) for number, damage in enumerate(known.damages)
    )


def _is_on_lsl_clock(stream: KeptStream) -> bool:
    first, last = stream.first, stream.last
    is_finite = math.isfinite(first) and math.isfinite(last)
    return (
        bool(stream.sample_count)
        and is_finite
        and not clock_error(stream.header, stream.clock_offsets, first, last)
    )


def _place(damage: Damage, number: int, streams: Sequence[KeptStream], begin: float) -> Place:
    around = [
        _on_recorder_clock(each, stream.offset_s)
        for stream in streams
        for each in stream.breaks
        if each.first <= number < each.end
    ]
    gaps = [each for each in around if each.is_gap]
    if gaps:
        before, after = min(each.before for each in gaps), max(each.after for each in gaps)
    elif around:
        # Chunks of different streams do not come strictly in the order of time.
        before, after = _innermost(around)
    else:
        before = max((each.last + each.offset_s for each in streams), default=math.nan)
        after = math.nan
    return Place(damage, before - begin, after - begin)


def _on_recorder_clock(each: Break, offset_s: float) -> Break:
    return each._replace(before=each.before + offset_s, after=each.after + offset_s)


def _innermost(breaks: Sequence[Break]) -> tuple[float, float]:
    before = [each.before for each in breaks if not math.isnan(each.before)]
    after = min(each.after for each in breaks)
    return (min(max(before), after), max(*before, after)) if before else (math.nan, after)
