"""Formats the report as text for users and as JSON for scripts."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any, cast

from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.figures import seconds_text
from biosensor_gateway.recording.xdf.findings import About, Finding, Level, by_event
from biosensor_gateway.recording.xdf.report import Measured, Report

_GAPS_SHOWN = 5
PAGE = "docs/recording-troubleshooting.md"
_HEADINGS = {
    About.PERSONS: "",
    About.OTHERS: "of other programs' streams:",
    About.OURSELVES: "of what agent and node record about themselves:",
}


def as_json(report: Report) -> str:
    """Return the report as JSON; gaps are in s since the start of the recording, NaN is null."""
    recording = report.recording
    content = {
        "file": str(recording.path),
        "bytes": recording.size,
        "begun": recording.begun,
        "length_s": report.extent.length_s,
        "good": report.is_good,
        "can_be_salvaged": report.can_be_salvaged,
        "damages": [asdict(damage) for damage in recording.damages],
        "streams": [_stream_as_json(each, report) for each in report.streams],
        "findings": [_finding_as_json(finding) for finding in report.findings],
    }
    return json.dumps(finite(content), indent=2, allow_nan=False)


def _finding_as_json(finding: Finding) -> dict[str, object]:
    explained = EXPLANATIONS.get(finding.code)
    more = {"means": explained.means, "to_do": explained.to_do} if explained else {}
    return {**asdict(finding), **more}


def finite(content: object) -> object:
    """Replace NaN and infinity, which JSON does not have; only damaged files contain them."""
    if isinstance(content, dict):
        items = cast("dict[str, object]", content).items()
        return {key: finite(value) for key, value in items}
    if isinstance(content, list | tuple):
        return [finite(value) for value in cast("Sequence[object]", content)]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def printable(text: str) -> str:
    """Replace control characters, so that recorded text cannot control the terminal."""
    return "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text)


def _stream_as_json(measured: Measured, report: Report) -> dict[str, Any]:
    stream, figures = measured.stream, measured.figures
    header = stream.header
    counters = measured.counters
    return {
        "name": header.name,
        "type": header.content_type,
        "source_id": header.source_id,
        "host": header.hostname,
        "channels": list(header.labels),
        "format": header.format.value,
        "nominal_hz": header.rate,
        "can_drop_samples": header.can_drop_samples,
        "ours": header.is_ours,
        "replay": None if header.replay is None else asdict(header.replay),
        "samples": stream.sample_count,
        "footer_samples": None if stream.footer is None else stream.footer.sample_count,
        "has_footer": stream.footer is not None,
        "first_s": figures.first,
        "last_s": figures.last,
        "measured_hz": figures.rate_hz,
        "measured_between_gaps_hz": figures.rate_between_gaps_hz,
        "backward_steps": figures.backward_steps,
        "bad_stamps": figures.bad_stamps,
        "on_lsl_clock": not figures.clock_error,
        "clock_offsets": asdict(figures.offsets),
        "gaps": {
            "count": figures.gaps.count,
            "lost": figures.gaps.lost,
            "total_s": figures.gaps.total_s,
            "listed": [
                {
                    "at_s": report.extent.since_begin(gap.after, measured),
                    "length_s": gap.length_s,
                    "lost": gap.lost,
                }
                for gap in figures.gaps.listed
            ],
        },
        "nan_shares": list(figures.nan_shares),
        "counted": None if counters is None else asdict(counters),
    }


def as_text(report: Report) -> str:
    """Return the report as text."""
    lines = [line for each in report.streams for line in _stream_lines(each, report)]
    # Events first, since a consequence may be about another subject than its event.
    for about, events in groupby(by_event(report.findings), key=lambda each: each[0].about):
        lines += [heading] if (heading := _HEADINGS[about]) else []
        lines += [line for each in events for line in _event_lines(*each)]
    lines.append(_summary(report))
    if report.findings:
        lines.append(f"what each of these means, and what to do: {PAGE}")
    if report.can_be_salvaged:
        lines.append(
            "to write what can be read to another file: "
            f"biosensor-gateway xdf salvage {report.recording.path}"
        )
    return "\n".join(lines)


def finding_lines(findings: Sequence[Finding]) -> list[str]:
    """Return findings as lines, each followed by its consequences."""
    return [line for each in by_event(findings) for line in _event_lines(*each)]


def _event_lines(head: Finding, parts: Sequence[Finding]) -> Iterator[str]:
    yield f"{head.level}: {_sentence(head)}{'; because of that:' * bool(parts)}"
    yield from (f"    {_sentence(each)}" for each in parts)


def _sentence(finding: Finding) -> str:
    return printable(f"{finding.stream}: {finding.text}" if finding.stream else finding.text)


def _summary(report: Report) -> str:
    levels = Counter(finding.level for finding, _ in by_event(report.findings))
    counts = [
        f"{levels[level]} {level}{'' if levels[level] == 1 else 's'}"
        for level in Level
        if levels[level]
    ]
    streams = "1 stream" if len(report.streams) == 1 else f"{len(report.streams)} streams"
    return (
        f"{report.recording.path}: {streams}, {seconds_text(report.extent.length_s, 1)}; "
        f"{', '.join(counts) or 'no problem found'}"
    )


def _stream_lines(measured: Measured, report: Report) -> Iterator[str]:
    stream, figures = measured.stream, measured.figures
    header = stream.header
    owner = "ours" if header.is_ours else "another program's"
    if header.replay is not None:
        owner = f"{owner}, a replay of {printable(header.replay.title)}"
    rate = f"{header.rate:g} Hz" if header.is_regular else "irregular"
    channels = "1 channel" if header.channel_count == 1 else f"{header.channel_count} channels"
    kind, source_id = printable(header.content_type), printable(header.source_id)
    host = f"on {printable(header.hostname)}" if header.hostname else "on a computer without a name"
    yield (
        f"{printable(header.title)}: {kind}, {channels} of {header.format}, "
        f"{rate}, {owner}, {host}, source_id {source_id!r}"
    )
    yield f"    {', '.join(_sample_facts(measured))}"
    yield f"    {_offset_facts(measured)}"
    if figures.gaps.count:
        shown = [
            f"{gap.length_s:.3g} s at {report.extent.since_begin(gap.after, measured):.1f} s "
            f"({gap.lost})"
            for gap in figures.gaps.listed[:_GAPS_SHOWN]
        ]
        more = ", ..." if figures.gaps.count > len(shown) else ""
        yield f"    gaps (samples lost): {', '.join(shown)}{more}"
    if figures.pauses.count:
        paused = [
            f"{gap.length_s:.3g} s at {report.extent.since_begin(gap.after, measured):.1f} s"
            for gap in figures.pauses.listed[:_GAPS_SHOWN]
        ]
        more = ", ..." if figures.pauses.count > len(paused) else ""
        yield f"    paused: {', '.join(paused)}{more}"
    gappy = [
        f"{printable(label)} {share:.1%}"
        for label, share in zip(header.labels, figures.nan_shares, strict=True)
        if share
    ]
    if gappy:
        yield f"    without a value: {', '.join(gappy)}"
    counters = measured.counters
    if counters is not None:
        yield (
            f"    by the agent's count: {counters.pushed} pushed, {counters.held} of them held, "
            f"{counters.lost} lost before"
        )


def _sample_facts(measured: Measured) -> Iterator[str]:
    stream, figures = measured.stream, measured.figures
    yield "1 sample" if stream.sample_count == 1 else f"{stream.sample_count} samples"
    if figures.rate_hz is not None:
        yield f"{figures.rate_hz:.4g} Hz measured"
    if stream.footer is None:
        yield "no footer"
    elif stream.footer.sample_count == stream.sample_count:
        yield "footer agrees"
    else:
        yield f"footer says {stream.footer.sample_count}"


def _offset_facts(measured: Measured) -> str:
    offsets = measured.figures.offsets
    if offsets.lowest_s is None or offsets.highest_s is None:
        return "no clock offsets"
    drift = offsets.drift_ppm
    drift_text = "" if drift is None or not math.isfinite(drift) else f", drift {drift:.2g} ppm"
    count = "1 clock offset" if offsets.count == 1 else f"{offsets.count} clock offsets"
    return f"{count}, {offsets.lowest_s * 1e3:.3f} to {offsets.highest_s * 1e3:.3f} ms{drift_text}"
