"""Compares a recording with the streams it should have, and decides if it can be trusted."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum, unique
from pathlib import Path
from typing import Any, NamedTuple, cast

from biosensor_common import naming
from biosensor_gateway.devices.registry import declared
from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.xdf.container import Damage
from biosensor_gateway.recording.xdf.counters import Reading, compare, parse_readings, refusals
from biosensor_gateway.recording.xdf.event_rules import (
    absences,
    clock_steps_s,
    consequence,
    judge_devices,
    without_pauses,
)
from biosensor_gateway.recording.xdf.figures import measure, seconds_text
from biosensor_gateway.recording.xdf.findings import (
    About,
    Finding,
    Level,
    VisibleStream,
    by_event,
    in_order,
    late_streams,
    other_participants,
    unreported,
)
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.recording import Recording, read_recording
from biosensor_gateway.recording.xdf.report import Measured, Report, extent
from biosensor_gateway.recording.xdf.stream_rules import absent_senders, judge_stream
from biosensor_gateway.settings.models import DeviceSettings

_MOST_DAMAGES = 10
# The fastest messages in a lab's network take no longer; a larger delay may be a clock error.
MAX_EDGE_S = 0.02
# This finding is detected in the agent's counters but concerns the sensors' streams.
_OF_PERSONS = frozenset({"held-up"})
_IN_ORDER = ("synchronised", "unknown", "")


def judge(
    recording: Recording, expected: Sequence[ExpectedStream] = (), without: Collection[str] = ()
) -> Report:
    """Measure every stream of a recording and report what is wrong; see `verdict.check`."""
    streams = [Measured(stream, measure(stream)) for stream in recording.streams]
    streams, findings = compare_with_agent(without_pauses(streams, extent(streams)))
    length = extent(streams)
    away = absences(streams, length, without)
    away += absent_senders(streams, length, away)
    findings = [
        *_damaged(recording),
        *_not_closed(recording),
        *other_participants(recording.path, (each.header.identity for each in recording.streams)),
        *_missing(streams, expected),
        *_duplicates(streams),
        *_unaligned(streams),
        *_replayed(streams),
        *(each.finding for each in away),
        *judge_devices(streams, length),
        *judge_robot_clocks(streams),
        *findings,
        *(
            consequence(
                finding if finding.code in _OF_PERSONS else finding.of(about(each.stream.header)),
                each,
                length,
                away,
            )
            for each in streams
            for finding in judge_stream(each, length)
        ),
    ]
    if not _has_footers(recording):
        # Reported once for the whole file.
        findings = [finding for finding in findings if finding.code != "no-footer"]
    return Report(recording, tuple(streams), length, tuple(in_order(findings)))


def about(header: RecordedHeader) -> About:
    """Return the subject of a finding about a stream."""
    if not header.is_ours:
        return About.OTHERS
    is_own = header.is_counters or header.is_events or header.is_events_of_node
    return About.OURSELVES if is_own else About.PERSONS


def _damaged(recording: Recording) -> Iterator[Finding]:
    foreign = [each for each in recording.damages if each.is_foreign]
    if foreign:
        chunks = "1 chunk is" if len(foreign) == 1 else f"{len(foreign)} chunks are"
        text = f"{chunks} skipped ({foreign[0].what}); everything else was read"
        yield Finding(Level.WARNING, "foreign-chunk", "", text)
    damages = [each for each in recording.damages if not each.is_foreign]
    for damage in damages[:_MOST_DAMAGES]:
        yield Finding(Level.ERROR, "damaged", "", _damage_text(damage, recording.size))
    more = len(damages) - _MOST_DAMAGES
    if more > 0:
        yield Finding(Level.ERROR, "damaged", "", f"{more} more places cannot be read")
    if recording.orphans:
        count = sum(recording.orphans.values())
        numbers = ", ".join(str(number) for number in sorted(recording.orphans)[:_MOST_DAMAGES])
        text = f"{count} chunks belong to streams without a header (number {numbers})"
        yield Finding(Level.ERROR, "no-header", "", text)
    for stream in recording.renumbered:
        text = (
            "it follows another stream with the same number, as if two recordings had been "
            "joined; other programs confuse the two, and xdf salvage gives each its own number"
        )
        yield Finding(Level.WARNING, "one-number", stream.header.title, text)
    if not recording.streams:
        yield Finding(Level.ERROR, "no-streams", "", "the file holds no stream")
    elif not any(stream.sample_count for stream in recording.streams):
        yield Finding(Level.ERROR, "no-samples", "", "no stream of the file holds samples")


def _has_footers(recording: Recording) -> bool:
    return any(stream.footer is not None for stream in recording.streams)


def while_recorded(report: Report) -> Report:
    """Return the report on a file that is still being recorded, whose end is no damage."""
    recording = report.recording
    cuts = {_damage_text(each, recording.size) for each in recording.damages if each.breaks_off}
    text = "it is still being recorded: this is what is in it so far"
    findings = [
        Finding(Level.WARNING, "going-on", "", text),
        *(
            each
            for each in report.findings
            if each.code not in {"not-closed", "no-footer"} and each.text not in cuts
        ),
    ]
    return replace(report, findings=tuple(findings))


def _not_closed(recording: Recording) -> Iterator[Finding]:
    # LabRecorder gives no footer to the streams that it cannot record.
    due = any(each.header.is_recordable for each in recording.streams)
    if due and not _has_footers(recording):
        text = "no stream has a footer: the recorder was ended before it could close the file"
        yield Finding(Level.ERROR, "not-closed", "", text)


def _damage_text(damage: Damage, size: int) -> str:
    if damage.breaks_off:
        return (
            f"the file breaks off at byte {damage.start} of {size} ({damage.what}); "
            "everything before was read"
        )
    return (
        f"bytes {damage.start} to {damage.end} of {size} cannot be read ({damage.what}); "
        "the rest was read"
    )


def _missing(measured: Sequence[Measured], expected: Sequence[ExpectedStream]) -> Iterator[Finding]:
    for each in expected:
        found = [one for one in measured if each.is_met_by(one.stream.header)]
        if not found:
            text = "it was expected and is not in the recording"
            yield Finding(Level.ERROR, "missing", each.name, text)
        elif each.must_have_samples and not any(one.stream.sample_count for one in found):
            text = "it was expected and holds no samples"
            yield Finding(Level.ERROR, "expected-empty", each.name, text)


def _duplicates(measured: Sequence[Measured]) -> Iterator[Finding]:
    headers = [each.stream.header for each in measured]
    ids = Counter(each.source_id for each in headers)
    # One event, as with two agents, if it is so of many streams.
    together: dict[int, list[str]] = {}
    for source_id, count in ids.items():
        if source_id and count > 1:
            together.setdefault(count, []).append(source_id)
    told: dict[str, str] = {}
    for count, same in together.items():
        named = ", ".join(map(repr, same))
        text = f"{count} streams have the source_id {named}"
        if len(same) > 1:
            text = f"{count} streams each have the source_ids {named}"
        told |= dict.fromkeys(same, text)
        yield Finding(Level.ERROR, "duplicate-source-id", "", text)
    names = Counter(each.name for each in headers)
    for name, count in names.items():
        if count > 1:
            text = f"{count} streams have {f'the name {name!r}' if name else 'no name'}"
            causes = {told.get(each.source_id, "") for each in headers if each.name == name}
            part_of = causes.pop() if len(causes) == 1 else ""
            yield Finding(Level.WARNING, "duplicate-name", "", text, part_of=part_of)


def _replayed(measured: Sequence[Measured]) -> Iterator[Finding]:
    """Report the streams of each replayed recording, once for each recording."""
    played = Counter(replay.title for each in measured if (replay := each.stream.header.replay))
    for title, count in played.items():
        streams = "1 stream is" if count == 1 else f"{count} streams are"
        text = f"{streams} a replay of {title}, and not measured during this recording"
        yield Finding(Level.WARNING, "replay", "", text)


def _unaligned(measured: Sequence[Measured]) -> Iterator[Finding]:
    filled = [each for each in measured if each.stream.sample_count]
    hosts = {each.stream.header.hostname for each in filled} - {""}
    bare = [each.name for each in filled if not each.figures.offsets.count]
    if len(hosts) > 1 and bare:
        text = (
            f"the streams come from {len(hosts)} computers, and without clock offsets "
            f"{len(bare)} of them cannot be aligned with the others"
        )
        yield Finding(Level.ERROR, "not-aligned", "", text)


class _Told(NamedTuple):
    """The node's report on one clock at one moment."""

    word: str
    edge_s: float

    @property
    def is_doubtful(self) -> bool:
        return self.word not in _IN_ORDER or abs(self.edge_s) >= MAX_EDGE_S


def judge_robot_clocks(streams: Sequence[Measured]) -> Iterator[Finding]:
    """Report the streams of topics whose clock may be wrong."""
    heard = {
        each.stream.header.hostname: list(_heartbeats(each.stream.texts))
        for each in streams
        if each.stream.header.is_events_of_node
    }
    for each in streams:
        header = each.stream.header
        robot = header.robot
        if robot is None or header.replay is not None:
            continue
        told = [_Told(robot.clock, robot.edge_s)]
        for topics in heard.get(header.hostname, ()):
            told += _clocks(topics.get(robot.topic))
        doubts = [one for one in told if one.is_doubtful]
        if doubts:
            worst = max(doubts, key=lambda one: 0.0 if math.isnan(one.edge_s) else abs(one.edge_s))
            text = f"{_how_far(worst)}; its first sample has the time of its {robot.stamped_by}"
            yield Finding(Level.WARNING, "robot-clock", header.title, text)


def _how_far(told: _Told) -> str:
    if math.isnan(told.edge_s):
        return "the clock of the robot is not known to be right"
    if told.edge_s < 0:
        return f"the clock of the robot is {-told.edge_s:.3f} s ahead, at least"
    if told.word == "wrong":
        return f"the clock of the robot is wrong: about {told.edge_s:.3f} s behind"
    return f"the clock of the robot may be behind by up to {told.edge_s:.3f} s"


def _heartbeats(texts: Iterable[str]) -> Iterator[Mapping[str, Any]]:
    for text in texts:
        try:
            yield _inside(json.loads(text), "topics")
        except (ValueError, RecursionError):
            continue


def _clocks(topic: object) -> Iterator[_Told]:
    for each in _inside(topic, "clocks").values():
        try:
            yield _Told(str(each["state"]), float(each["edge_s"]))
        except (TypeError, KeyError, ValueError, OverflowError):
            continue


def _inside(content: object, name: str) -> Mapping[str, Any]:
    """Return an object inside another one; empty if there is none."""
    inner = cast("Mapping[str, object]", content).get(name) if isinstance(content, dict) else None
    nothing: Mapping[str, Any] = {}
    return cast("Mapping[str, Any]", inner) if isinstance(inner, dict) else nothing


def compare_with_agent(streams: Sequence[Measured]) -> tuple[list[Measured], list[Finding]]:
    """Compare every stream with the counters of the agent on its computer.

    Returns
    -------
    list of Measured
        The same streams, with the comparison where one is possible.
    list of Finding
        Findings about the counters themselves.
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
            found = Finding(Level.ERROR, "counters", header.title, text, About.OURSELVES)
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
    return replace(stream, counters=compare(run, stream.stream.stamps_in_blocks, end))


def _refused(stream: Measured, run: Sequence[Reading]) -> Iterator[Finding]:
    for sentence in refusals(run):
        yield Finding(Level.WARNING, "refused", stream.stream.header.title, sentence)


def _left_out(
    streams: Sequence[Measured], readings: Mapping[str, Sequence[Reading]], counters: RecordedHeader
) -> Iterator[Finding]:
    """Report streams that were pushed but not recorded, once for each device."""
    of_device: dict[str, list[str]] = {}
    for source_id, run in readings.items():
        was_pushed = run[-1].pushed > run[0].pushed
        if was_pushed and not _places(streams, source_id, counters.hostname):
            # No other part of a source_id contains a hyphen.
            of_device.setdefault(source_id.rpartition("-")[0], []).append(source_id)
    for device, ids in of_device.items():
        if len(ids) == 1:
            text = f"the agent also had the stream {ids[0]}, which was not recorded"
        else:
            names = listed(each.rpartition("-")[2] for each in ids)
            text = f"the agent also had {device}, of which {names} were not recorded"
        yield Finding(Level.ERROR, "left-out", counters.name, text)


def _uncounted(streams: Sequence[Measured]) -> Iterator[Finding]:
    # The agent counts neither replays nor a node's own streams.
    counted = [each.stream.header for each in streams if each.stream.header.is_of_agent]
    if counted and not any(header.is_counters for header in counted):
        text = "the agent's counters were not recorded, so nothing can be compared with them"
        yield Finding(Level.NOTE, "no-counters", "", text)


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
    """The result of a check, as plain values."""

    file: str
    bytes: int
    colour: Colour
    sentence: str  # A summary.
    length_s: float  # Time from the first sample of any stream to the last.
    streams: tuple[JudgedStream, ...]
    # Sorted by subject, then the worst first; a green recording has only notes.
    findings: tuple[Finding, ...]
    can_be_salvaged: bool  # Whether it is truncated or damaged, but samples can be read.


def check(
    file: Path,
    expected: Sequence[ExpectedStream] = (),
    without: Collection[str] = (),
    told: Iterable[str] = (),
    late: Sequence[VisibleStream] = (),
    clock_set: Sequence[tuple[float, Finding]] = (),
) -> Verdict:
    """Read a recording and check it.

    Parameters
    ----------
    without
        source_ids of sensors that the user has excluded.
    told
        The recorder's messages that matter for the analysis.
    late
        Streams that appeared after the recording began.
    clock_set
        Steps of the recorder's clock, as for `unreported`: an agent's events in the file report
        them more exactly.

    Raises
    ------
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file.
    """
    report = judge(read_recording(file), expected, without)
    headers = (each.stream.header for each in report.streams)
    findings = [
        *report.findings,
        *unreported(clock_set, clock_steps_s(report.streams) if clock_set else ()),
        *(Finding(Level.WARNING, "told", "", each) for each in told),
        *late_streams(late, {(each.name, each.source_id) for each in headers}),
    ]
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
    what = f"{streams}, {seconds_text(report.extent.length_s, 1)}: "
    if colour is Colour.GREEN:
        return f"{what}all is there"
    worst = Level.ERROR if colour is Colour.RED else Level.WARNING
    count = sum(finding.level is worst for finding, _ in by_event(report.findings))
    if colour is Colour.RED:
        things = "1 thing is" if count == 1 else f"{count} things are"
        return f"{what}{things} wrong or missing in the file"
    things = "1 thing" if count == 1 else f"{count} things"
    return f"{what}the file is intact, but {things} happened that the analysis must consider"


@dataclass(frozen=True, slots=True)
class ExpectedStream:
    """A stream that should be there."""

    name: str
    source_id: str = ""  # Empty if only `name` is known, which may then be a name or a source_id.
    # Whether samples are expected too; an event stream may be empty.
    must_have_samples: bool = False

    def is_met_by(self, header: RecordedHeader) -> bool:
        """Whether a recorded stream matches."""
        if self.source_id:
            return header.source_id == self.source_id
        return self.name in (header.name, header.source_id)


def by_name(names: Iterable[str]) -> tuple[ExpectedStream, ...]:
    """Return expected streams, given by name or source_id; each must have samples."""
    return tuple(ExpectedStream(name, must_have_samples=True) for name in names)


def by_devices(devices: Iterable[DeviceSettings]) -> tuple[ExpectedStream, ...]:
    """Return every stream of every enabled device in the settings.

    Raises
    ------
    SpecError
        If a sensor's declaration cannot be loaded.
    """
    expected: list[ExpectedStream] = []
    for device in devices:
        if device.enabled:
            identity = device.identity
            expected += [
                ExpectedStream(
                    naming.lsl_name(identity, stream.data_name),
                    naming.source_id(identity, stream.data_name),
                )
                for stream in declared(device).streams
            ]
    return tuple(expected)
