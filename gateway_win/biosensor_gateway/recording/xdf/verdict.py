"""Sums up the check of a recording in a colour and sentences."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum, unique
from pathlib import Path

from biosensor_gateway.recording.xdf.expectation import ExpectedStream
from biosensor_gateway.recording.xdf.findings import Finding, Level, in_order
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report import Report


@unique
class Colour(StrEnum):
    """How good a recording is.

    ``GREEN``: nothing is wrong. ``AMBER``: the file is intact, but something happened that matters
    for the analysis. ``RED``: something is wrong or missing in the file.
    """

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


@dataclass(frozen=True, slots=True)
class JudgedStream:
    """One stream of the recording; `lost` comes from the agent's count, None without one."""

    name: str
    source_id: str
    samples: int
    gaps: int
    lost: int | None


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of a check, as plain values.

    Attributes
    ----------
    sentence
        A summary.
    length_s
        Time from the first sample of any stream to the last.
    findings
        Sorted by subject, then the worst first; a green recording has only notes.
    can_be_salvaged
        Whether it is truncated or damaged, but samples can be read.
    """

    file: str
    bytes: int
    colour: Colour
    sentence: str
    length_s: float
    streams: tuple[JudgedStream, ...]
    findings: tuple[Finding, ...]
    can_be_salvaged: bool


def check(
    file: Path,
    expected: Sequence[ExpectedStream] = (),
    without: Collection[str] = (),
    told: Iterable[str] = (),
) -> Verdict:
    """Read a recording and check it.

    Parameters
    ----------
    without
        source_ids of sensors that the user has excluded.
    told
        The recorder's messages that matter for the analysis.

    Raises
    ------
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file.
    """
    report = judge(read_recording(file), expected, without)
    findings = [*report.findings, *(Finding(Level.WARNING, "told", "", each) for each in told)]
    return verdict(replace(report, findings=tuple(in_order(findings))))


def verdict(report: Report) -> Verdict:
    """Turn a report into a verdict."""
    colour = _colour(report)
    return Verdict(
        file=str(report.recording.path),
        bytes=report.recording.size,
        colour=colour,
        sentence=_sentence(report, colour),
        length_s=report.extent.length_s,
        streams=tuple(
            JudgedStream(
                name=each.name,
                source_id=each.stream.header.source_id,
                samples=each.stream.sample_count,
                gaps=each.figures.gaps.count,
                lost=None if each.counters is None else each.counters.lost,
            )
            for each in report.streams
        ),
        findings=report.findings,
        can_be_salvaged=report.can_be_salvaged,
    )


def _colour(report: Report) -> Colour:
    levels = {finding.level for finding in report.findings}
    if Level.ERROR in levels:
        return Colour.RED
    return Colour.AMBER if Level.WARNING in levels else Colour.GREEN


def _sentence(report: Report, colour: Colour) -> str:
    streams = "1 stream" if len(report.streams) == 1 else f"{len(report.streams)} streams"
    what = f"{streams}, {report.extent.length_s:.1f} s: "
    if colour is Colour.GREEN:
        return f"{what}all is there"
    worst = Level.ERROR if colour is Colour.RED else Level.WARNING
    count = sum(finding.level is worst for finding in report.findings)
    if colour is Colour.RED:
        things = "1 thing is" if count == 1 else f"{count} things are"
        return f"{what}{things} wrong or missing in the file"
    things = "1 thing" if count == 1 else f"{count} things"
    return f"{what}the file is intact, but {things} happened that the analysis must consider"
