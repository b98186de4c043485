"""Finds the rate of streams whose header names none, though their samples come evenly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.xdf.measuring import first_of, may_have_rate
from biosensor_gateway.recording.xdf.pace import rate_of


def estimated_rate(stream: Stream) -> float | None:
    """Return the rate of a stream whose header names none; None if its samples do not tell one."""
    if not may_have_rate(stream.header):
        return None
    return rate_of(first_of(samples.stamps for samples in stream.blocks()))


def with_rates(
    streams: Sequence[Stream], wanted: Mapping[str, float]
) -> tuple[tuple[Stream, ...], list[str]]:
    """Return streams as if headers named the rates that they have, and what is to be said of it.

    Parameters
    ----------
    wanted
        Rates in Hz that somebody knows of streams without one, by name or source_id, with ``*`` and
        ``?``.
    """
    found: list[Stream] = []
    notes: list[str] = []
    for stream in streams:
        name = stream.header.name
        known = [hz for fit, hz in wanted.items() if _fits(stream, fit)]
        rate_hz = known[0] if known else estimated_rate(stream)
        if stream.header.is_regular or rate_hz is None:
            found.append(stream)
            continue
        found.append(stream.with_rate(rate_hz))
        taken = (
            f"about {rate_hz:.6g} Hz, as --rate says"
            if known
            else f"{rate_hz:.6g} Hz, that of a line through its stamps"
        )
        notes.append(f"{name}: its header names no rate; it is taken as {taken}")
    without = [each for each in streams if not each.header.is_regular]
    notes += [
        f"--rate {fit}: no stream without a rate is called that"
        for fit in wanted
        if not any(_fits(each, fit) for each in without)
    ]
    return tuple(found), notes


def _fits(stream: Stream, pattern: str) -> bool:
    names = (stream.header.name, stream.header.source_id)
    return any(fnmatchcase(each, pattern) for each in names)
