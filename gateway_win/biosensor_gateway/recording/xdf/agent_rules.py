"""Compares the capture agent's counts with the recorded streams."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.xdf.counters import Reading, compare, parse_readings, refusals
from biosensor_gateway.recording.xdf.findings import About, Finding, Level
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.report import Measured


def compare_with_agent(streams: Sequence[Measured]) -> tuple[list[Measured], list[Finding]]:
    """Compare every stream with the counters of the agent on its computer.

    Returns
    -------
    list of Measured
        The same streams, with the comparison where there is one.
    list of Finding
        What is to be said of the counters themselves.
    """
    compared = list(streams)
    findings: list[Finding] = []
    for counters in streams:
        header = counters.stream.header
        if not header.is_counters:
            continue
        readings, unreadable = parse_readings(counters.stream.texts, counters.stream.stamps)
        if unreadable:
            text = f"{unreadable} of its samples cannot be read"
            found = Finding(Level.ERROR, "counters", header.name, text, About.OURSELVES)
            findings.append(found)
        for source_id, run in readings.items():
            places = _places(streams, source_id, header.hostname)
            for at in places:
                compared[at] = _compared(streams[at], run, counters)
                findings += _refused(streams[at], run)
        findings += _left_out(streams, readings, header)
    findings += _uncounted(streams)
    return compared, findings


def _places(streams: Sequence[Measured], source_id: str, hostname: str) -> list[int]:
    headers = [each.stream.header for each in streams]
    return [
        at
        for at, header in enumerate(headers)
        if (header.source_id, header.hostname) == (source_id, hostname)
    ]


def _compared(stream: Measured, run: Sequence[Reading], counters: Measured) -> Measured:
    end = counters.figures.last
    if end is None:
        return stream
    return replace(stream, counters=compare(run, stream.stream.stamps, end))


def _refused(stream: Measured, run: Sequence[Reading]) -> Iterator[Finding]:
    for sentence in refusals(run):
        yield Finding(Level.WARNING, "refused", stream.stream.header.name, sentence)


def _left_out(
    streams: Sequence[Measured], readings: Mapping[str, Sequence[Reading]], counters: RecordedHeader
) -> Iterator[Finding]:
    """Name what was pushed and not recorded, once for each device."""
    of_device: dict[str, list[str]] = {}
    for source_id, run in readings.items():
        was_pushed = run[-1].pushed > run[0].pushed
        if was_pushed and not _places(streams, source_id, counters.hostname):
            # No other part of a source_id has this sign.
            of_device.setdefault(source_id.rpartition("-")[0], []).append(source_id)
    for device, ids in of_device.items():
        if len(ids) == 1:
            text = f"the agent also had the stream {ids[0]}, which was not recorded"
        else:
            names = listed(each.rpartition("-")[2] for each in ids)
            text = f"the agent also had {device}, of which {names} were not recorded"
        yield Finding(Level.ERROR, "left-out", counters.name, text)


def _uncounted(streams: Sequence[Measured]) -> Iterator[Finding]:
    # Of a replay nobody counts, nor of what a node says of itself.
    counted = [each.stream.header for each in streams if each.stream.header.is_of_agent]
    if counted and not any(header.is_counters for header in counted):
        text = "the agent's counters were not recorded, so nothing can be compared with them"
        yield Finding(Level.NOTE, "no-counters", "", text)
