"""Compares the capture agent's counts with the recorded streams."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from biosensor_gateway.recording.xdf.counters import Reading, compare, parse_readings
from biosensor_gateway.recording.xdf.findings import Finding, Level
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
        readings, unreadable = parse_readings(counters.stream.texts)
        if unreadable:
            text = f"{unreadable} of its samples cannot be read"
            findings.append(Finding(Level.ERROR, "counters", header.name, text))
        for source_id, run in readings.items():
            places = _places(streams, source_id, header.hostname)
            for at in places:
                compared[at] = _compared(streams[at], run, counters)
            if not places:
                findings += _left_out(source_id, run, header.name)
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


def _left_out(source_id: str, run: Sequence[Reading], name: str) -> Iterator[Finding]:
    if run[-1].pushed > run[0].pushed:
        text = f"the agent also had the stream {source_id}, which was not recorded"
        yield Finding(Level.ERROR, "left-out", name, text)


def _uncounted(streams: Sequence[Measured]) -> Iterator[Finding]:
    # Of a replay nobody counts, nor of what a node says of itself.
    counted = [each.stream.header for each in streams if each.stream.header.is_of_agent]
    if counted and not any(header.is_counters for header in counted):
        text = "the agent's counters were not recorded, so nothing can be compared with them"
        yield Finding(Level.NOTE, "no-counters", "", text)
