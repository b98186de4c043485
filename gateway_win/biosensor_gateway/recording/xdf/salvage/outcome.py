"""Salvages a recording, and reports what was kept and what is lost, as sentences and as JSON."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_gateway.recording.xdf.chunks import footer
from biosensor_gateway.recording.xdf.container import (
    BOUNDARY,
    MAGIC,
    STREAM_ID_BYTES,
    Damage,
    RecordingError,
    RecordingReason,
    Tag,
    framed,
    open_recording,
    read_frame,
)
from biosensor_gateway.recording.xdf.figures import Course, clock_error
from biosensor_gateway.recording.xdf.recording import repeated_text
from biosensor_gateway.recording.xdf.report_text import finite, printable
from biosensor_gateway.recording.xdf.salvage.survey import (
    Break,
    KeptStream,
    Rewrite,
    Survey,
    survey,
)
from biosensor_gateway.system.new_file import new_file

SUFFIX = ".xdf"
_ADDED = "_salvaged"
_PACKED_SUFFIXES = frozenset({".gz", ".xdfz"})
_BLOCK_BYTES = 1 << 20
_FILE_HEADER = b'<?xml version="1.0"?><info><version>1.0</version></info>'


HEADINGS = ("stream", "samples kept", "lost")
_MOST_PLACES = 10


@dataclass(frozen=True, slots=True)
class Place:
    """Damaged bytes, with their time in s since the start; NaN where unknown."""

    damage: Damage
    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of salvaging a recording."""

    path: Path
    written: Path | None  # The new file; None if the recording is undamaged.
    survey: Survey
    places: tuple[Place, ...]
    closed: tuple[int, ...]  # Numbers of the streams that got a footer.

    @property
    def lost_bytes(self) -> int:
        """Bytes of the recording that are not in the new file, without footers."""
        orphans = sum(each.bytes for each in self.survey.orphans.values())
        return orphans + sum(each.damage.end - each.damage.start for each in self.places)


def salvaged_path(path: Path) -> Path:
    """Return the default path of the salvaged recording, next to the original."""
    bare = path
    for suffixes in (_PACKED_SUFFIXES, {SUFFIX}):
        if bare.suffix.lower() in suffixes:
            bare = bare.with_suffix("")
    return bare.with_name(f"{bare.name}{_ADDED}{SUFFIX}")


def salvage(path: Path, target: Path, headers_from: Path | None = None) -> Outcome:
    """Write the readable parts of a damaged recording to another file.

    Parameters
    ----------
    headers_from
        Another recording of the same streams, to replace lost headers: of the stream with the same
        name if that is still readable, else with the same number.

    Raises
    ------
    ConfigError
        If `target` exists or has a wrong suffix.
    RecordingError
        If `path` cannot be read or has no samples, or the other file cannot be written.
    """
    if target.suffix.lower() != SUFFIX:
        message = f"{target} will not be compressed; give it a name that ends in {SUFFIX}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    with open_recording(path) as opened:
        known = survey(path, opened)
        if headers_from is not None and known.orphans:
            known = survey(path, opened, _lost_headers(known, headers_from))
        outcome = Outcome(path, None, known, _places(known), tuple(known.footers_due()))
        if known.is_whole:
            return outcome
        if not known.sample_count:
            message = f"{path} holds no readable samples, so nothing was written"
            raise RecordingError(RecordingReason.EMPTY, message)
        _refuse_to_overwrite(target)
        write_salvaged(opened.file, known, target, path)
    return Outcome(path, target, known, outcome.places, outcome.closed)


def _lost_headers(known: Survey, headers_from: Path) -> dict[int, bytes]:
    with open_recording(headers_from) as opened:
        others = survey(headers_from, opened).streams
    by_name = {each.header.name: each.header for each in others.values()}
    found: dict[int, bytes] = {}
    for number, orphans in known.orphans.items():
        numbered = others[number].header if number in others else None
        header = by_name.get(orphans.name) if orphans.name else numbered
        if header is not None:
            found[number] = header.xml.encode()
    return found


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
    ends = np.array([stream.first, stream.last])
    return (
        bool(stream.sample_count)
        and bool(np.isfinite(ends).all())
        and not clock_error(stream.header, stream.clock_offsets, Course.of([ends]), 0)
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
        # Chunks of different streams are not strictly in time order.
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


def write_salvaged(source: BinaryIO, survey: Survey, target: Path, original: Path) -> None:
    """Write all valid chunks unchanged, and add missing footers.

    Parameters
    ----------
    source
        The recording, uncompressed.
    original
        The original file, whose access rights the new file gets.

    Raises
    ------
    RecordingError
        If it cannot be written; no new file is left behind.
    """
    try:
        with new_file(target, like=original) as file:
            _write(source, survey, file)
    except FileExistsError:
        message = f"{target} exists and is not overwritten"
        raise RecordingError(RecordingReason.UNWRITABLE, message) from None
    except OSError as error:
        message = cannot_write(target, error)
        raise RecordingError(RecordingReason.UNWRITABLE, message) from error


def _write(source: BinaryIO, survey: Survey, target: BinaryIO) -> None:
    target.write(MAGIC)
    if not survey.has_file_header:
        target.write(framed(Tag.FILE_HEADER, _FILE_HEADER))
    position = len(MAGIC)
    for start, end, instead in survey.changes():
        _copy(source, position, start, target)
        content = _rewritten(source, instead) if isinstance(instead, Rewrite) else instead
        # A boundary chunk is allowed anywhere, so it marks the place of removed bytes.
        target.write(framed(Tag.BOUNDARY, BOUNDARY) if content is None else content)
        position = end
    _copy(source, position, survey.size, target)
    for number in survey.footers_due():
        target.write(footer(number, survey.streams[number]))


def _copy(source: BinaryIO, start: int, end: int, target: BinaryIO) -> None:
    source.seek(start)
    while start < end:
        block = source.read(min(_BLOCK_BYTES, end - start))
        if not block:
            raise OSError("the recording has become shorter in the meantime")
        target.write(block)
        start += len(block)


def _rewritten(source: BinaryIO, chunk: Rewrite) -> bytes:
    """Return a chunk with its number, and a timestamp added to its first sample."""
    frame = read_frame(source, chunk.start)
    source.seek(frame.content_start + STREAM_ID_BYTES)
    content = chunk.number.to_bytes(STREAM_ID_BYTES, "little") + source.read(
        chunk.end - frame.content_start - STREAM_ID_BYTES
    )
    if chunk.stamp is None:
        return framed(Tag(frame.tag), content)
    # The first sample follows the stream's number and the count with its size.
    first = STREAM_ID_BYTES + 1 + content[STREAM_ID_BYTES]
    stamp = b"\x08" + struct.pack("<d", chunk.stamp)
    return framed(Tag.SAMPLES, content[:first] + stamp + content[first + 1 :])


def as_json(outcome: Outcome) -> str:
    """Return the outcome as JSON; times are in s since the start, NaN is null."""
    known = outcome.survey
    content = {
        "file": str(outcome.path),
        "bytes": known.size,
        "whole": known.is_whole,
        "written": None if outcome.written is None else str(outcome.written),
        "lost_bytes": outcome.lost_bytes,
        "damages": [
            {**asdict(each.damage), "begin_s": each.begin_s, "end_s": each.end_s}
            for each in outcome.places
        ],
        "streams": [
            {
                "number": number,
                "name": stream.header.name,
                "source_id": stream.header.source_id,
                "kept": stream.sample_count,
                "lost": _lost(stream),
                "lost_is_exact": _counted_before(stream) is not None,
                "cut": stream.cut is not None,
                "repeated": stream.repeated,
                "restamped": len(stream.restamps),
                "untimed": stream.untimed,
                "new_footer": number in outcome.closed,
                "new_header": number in known.new_headers,
            }
            for number, stream in known.streams.items()
        ],
        "left_out": [{"number": n, **asdict(each)} for n, each in known.orphans.items()],
    }
    return json.dumps(finite(content), indent=2, allow_nan=False)


def table(outcome: Outcome) -> list[tuple[str, str, str]]:
    """Return a row for each kept stream, with the columns of `HEADINGS`."""
    return [
        (printable(stream.header.title), str(stream.sample_count), _lost_text(stream))
        for stream in outcome.survey.streams.values()
    ]


def before_table(outcome: Outcome) -> Iterator[str]:
    """Yield sentences about the problems of the recording."""
    known, places = outcome.survey, outcome.places
    if known.is_whole:
        yield (
            f"{outcome.path} is whole: it can be read to its end, and every stream was closed; "
            "nothing was written"
        )
        return
    if not places:
        what = "was not closed" if known.unclosed else "holds samples twice"
        if known.orphans and not known.unclosed:
            what = "lacks headers of streams"
        if known.new_headers and not known.unclosed and not known.orphans:
            what = "has headers that other programs cannot read, or lacks some"
        elif known.renumbered and not known.unclosed:
            what = "uses one number for several streams"
        if any(each.cut for each in known.streams.values()) and not known.unclosed:
            what = "holds a last sample with the time of another"
        yield f"{outcome.path} can be read to its end, but {what}"
        return
    unreadable = sum(each.damage.end - each.damage.start for each in places)
    where = "1 place" if len(places) == 1 else f"{len(places)} places"
    yield f"{outcome.path}: {unreadable} of {known.size} bytes, in {where}, cannot be read"
    for place in places[:_MOST_PLACES]:
        yield f"  {_place_text(place)}"
    if len(places) > _MOST_PLACES:
        yield f"  and {len(places) - _MOST_PLACES} more"


def after_table(outcome: Outcome) -> Iterator[str]:
    """Yield sentences about the result."""
    known = outcome.survey
    for number, orphans in known.orphans.items():
        name = f" ({printable(orphans.name)})" if orphans.name else ""
        yield (
            f"left out: stream number {number}{name}, {orphans.bytes} bytes in {orphans.chunks} "
            "chunks, because its header is lost"
        )
    for number, new in known.new_headers.items():
        name = printable(known.streams[number].header.title)
        if new.wrong:
            yield f"{name}: its header was fixed; it had {', '.join(map(printable, new.wrong))}"
        else:
            yield f"{name}: its header is the other recording's; check whether it fits"
    for number in known.renumbered:
        name = printable(known.streams[number].header.title)
        yield f"{name}: it got the new number {number}, because another stream has its previous one"
    for stream in known.streams.values():
        yield from _stamps_text(stream)
    if outcome.closed:
        streams = "1 stream" if len(outcome.closed) == 1 else f"{len(outcome.closed)} streams"
        yield f"{streams} got a footer with the number of samples kept"
    yield f"wrote {outcome.written}; check it with: biosensor-gateway xdf check {outcome.written}"


def _counted_before(stream: KeptStream) -> int | None:
    return None if stream.footer is None else stream.footer.sample_count


def _lost(stream: KeptStream) -> int:
    counted = _counted_before(stream)
    if counted is None:
        return stream.lost
    # A recorder may have counted what it wrote, or what it received.
    held = stream.sample_count + stream.repeated
    return 0 if counted == held else max(0, counted - stream.sample_count)


def _lost_text(stream: KeptStream) -> str:
    lost = _lost(stream)
    if _counted_before(stream) is not None:
        return str(lost)
    return f"at least {lost}" if lost else "not known"


def _place_text(place: Place) -> str:
    damage = place.damage
    where = (
        f"from byte {damage.start}"
        if damage.breaks_off
        else f"bytes {damage.start} to {damage.end}"
    )
    return f"{where}, {_time_text(place)} ({damage.what})"


def _time_text(place: Place) -> str:
    begin, end = place.begin_s, place.end_s
    if math.isfinite(begin) and math.isfinite(end):
        return f"between {begin:.1f} and {end:.1f} s"
    if math.isfinite(begin):
        return f"after {begin:.1f} s"
    return f"before {end:.1f} s" if math.isfinite(end) else "at an unknown time"


def _stamps_text(stream: KeptStream) -> Iterator[str]:
    name = printable(stream.header.title)
    if stream.cut is not None:
        yield (
            f"{name}: its last sample was cut off, because its timestamp is wrong: the outlet "
            "closed while it was recorded"
        )
    if stream.repeated:
        yield f"{name}: {repeated_text(stream.repeated)}"
    if stream.restamps:
        yield (
            f"{name}: the timestamps after {len(stream.restamps)} of the damaged places are "
            "calculated from the next one that could be read"
        )
    if stream.untimed:
        yield (
            f"{name}: {stream.untimed} samples after damaged bytes have no timestamp, so they "
            "may be later than stated"
        )
