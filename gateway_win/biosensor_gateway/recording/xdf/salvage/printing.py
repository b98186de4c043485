"""Formats the result of salvaging, as sentences for users and as JSON for scripts."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict

from biosensor_gateway.recording.xdf.printing import finite, printable
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome, Place
from biosensor_gateway.recording.xdf.salvage.survey import KeptStream

HEADINGS = ("stream", "samples kept", "lost")
_MOST_PLACES = 10


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
        (printable(stream.header.name), str(stream.sample_count), _lost_text(stream))
        for stream in outcome.survey.streams.values()
    ]


def before_table(outcome: Outcome) -> Iterator[str]:
    """Yield sentences about what is wrong with the recording."""
    known, places = outcome.survey, outcome.places
    if known.is_whole:
        yield (
            f"{outcome.path} is whole: it can be read to its end, and every stream was closed; "
            "nothing was written"
        )
        return
    if not places:
        what = "was not closed" if known.unclosed else "lacks headers of streams"
        if known.new_headers and not known.unclosed and not known.orphans:
            what = "has headers that others cannot read, or lacks some"
        if any(each.cut for each in known.streams.values()) and not known.unclosed:
            what = "holds a last sample of another time"
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
    """Yield sentences about what was done."""
    known = outcome.survey
    for number, orphans in known.orphans.items():
        name = f" ({printable(orphans.name)})" if orphans.name else ""
        yield (
            f"left out: stream number {number}{name}, {orphans.bytes} bytes in {orphans.chunks} "
            "chunks, because its header is lost"
        )
    for number, new in known.new_headers.items():
        name = printable(known.streams[number].header.name)
        if new.wrong:
            yield f"{name}: its header was fixed, which had {', '.join(map(printable, new.wrong))}"
        else:
            yield f"{name}: its header is that of the other recording; see whether it fits"
    for stream in known.streams.values():
        yield from _stamps_text(stream)
    if outcome.closed:
        streams = "1 stream" if len(outcome.closed) == 1 else f"{len(outcome.closed)} streams"
        yield f"{streams} got a footer, which counts what was kept"
    yield f"wrote {outcome.written}; look at it with: biosensor-gateway xdf check {outcome.written}"


def _counted_before(stream: KeptStream) -> int | None:
    return None if stream.footer is None else stream.footer.sample_count


def _lost(stream: KeptStream) -> int:
    counted = _counted_before(stream)
    return stream.lost if counted is None else max(0, counted - stream.sample_count)


def _lost_text(stream: KeptStream) -> str:
    lost = _lost(stream)
    if _counted_before(stream) is not None:
        return str(lost)
    return f"at least {lost}" if lost else "not known"


def _place_text(place: Place) -> str:
    damage = place.damage
    where = (
        f"from byte {damage.start} on"
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
    name = printable(stream.header.name)
    if stream.cut is not None:
        yield (
            f"{name}: its last sample was cut off, whose stamp is of another time: its outlet went "
            "while it was recorded"
        )
    if stream.restamps:
        yield (
            f"{name}: the stamps behind {len(stream.restamps)} of the damages are reckoned from "
            "the next that was there"
        )
    if stream.untimed:
        yield (
            f"{name}: {stream.untimed} samples after damaged bytes have no timestamp, so "
            "they may be later than they say"
        )
