"""Four agents, two robots and a recorder: one is cut off, and all is accounted for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import pyxdf
from numpy.typing import NDArray

from biosensor_common.quantities import ContentType
from biosensor_gateway.devices.registry import declaration
from tests.faults.expectations import regular_streams
from tests.faults.scenarios.figures import Record, is_long
from tests.faults.scenarios.holes import Hole, hole
from tests.faults.scenarios.many_computers import CUT_OFF, KILLED, RECORDER, Outcome, Stream, run
from tests.rigs.hosts.completeness import Recording, Span
from tests.rigs.hosts.link import Delays
from tests.rigs.hosts.sites import CLOCK_OFFSETS_S, DESK, PCS, ROBOTS, Setting, unix_s

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

# Four agents, two robots and a recorder: one is cut off, others are killed, all is accounted for.

TWO_SITES = Setting("two sites", Delays(0.030, 0.010), is_deaf=True)
MULTICAST = Setting("multicast", None, is_deaf=False)
KNOWN_PEERS = Setting("known_peers alone", None, is_deaf=True)
SETTINGS = (TWO_SITES, MULTICAST, KNOWN_PEERS) if is_long() else (TWO_SITES,)
ONE_EACH = ("zephyr", "empatica_e4", "shimmer3_gsr", "emotiv_insight")
WORN: Mapping[str, Sequence[str]] = (
    dict.fromkeys(PCS, ONE_EACH[:2])
    if is_long()
    else {p: (s,) for p, s in zip(PCS, ONE_EACH, strict=True)}
)
# From the time of a sample to its receipt: a packet holds those of a second, and is on its way
# over the link and through a node.
ON_ITS_WAY_S = 1.5
Holes = Mapping[Stream, Hole | None]


class Judged:
    """What is missing of each stream with a rate, by receiver and by time."""

    def __init__(self, setting: Setting, outcome: Outcome) -> None:
        self.setting, self.outcome = setting, outcome
        file = recorded(outcome.xdf, outcome.streams)
        self._received: dict[str, Callable[[Stream], Recording]] = {
            RECORDER: lambda stream: file[stream],
            **{each: self._of_robot(each) for each in ROBOTS},
        }
        self.receivers = tuple(self._received)

    def _of_robot(self, robot: str) -> Callable[[Stream], Recording]:
        topics = self.outcome.robots[robot].topics
        return lambda stream: topics[stream.topic]

    @property
    def streams(self) -> Iterator[Stream]:
        """Those that have a rate; a status says the same every second."""
        for each in self.outcome.streams:
            declared = declaration(each.sensor).stream(each.data_name)
            is_regular = each.data_name in regular_streams(each.sensor)
            if is_regular and declared.content_type is not ContentType.STATUS:
                yield each

    def holes(self, receiver: str, before: Span, after: Span) -> Holes:
        received = self._received[receiver]
        truth = self.outcome.truth
        return {s: hole(truth[s], received(s), before, after) for s in self.streams}

    def counted(self, robot: str, stream: Stream, before: Span, after: Span) -> int:
        """What the node of a robot counted as lost between two times."""
        facts = [self.outcome.robots[robot].facts_at(each.start) for each in (before, after)]
        return int(facts[1][stream.topic]["lost"]) - int(facts[0][stream.topic]["lost"])


@pytest.fixture(scope="module", params=SETTINGS, ids=lambda setting: setting.name)
def judged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Judged:
    setting: Setting = request.param
    return Judged(setting, run(setting, WORN, tmp_path_factory.mktemp("computers")))


def _fault(judged: Judged, what: str) -> str:
    return f"lab of many computers, {judged.setting.name}: {what}"


def _overlaps(hole: Hole, dead: Span) -> bool:
    """Whether samples are missing around a time in which a program was dead, and nowhere else.

    With a program dies what it had in hand, which was measured before.
    """
    return hole.begin_s <= dead.end and hole.end_s >= dead.start - ON_ITS_WAY_S


def test_all_streams_are_found(judged: Judged, figures: Record) -> None:
    outcome, title = judged.outcome, _fault(judged, "nothing yet")
    # Three of each agent itself come on top.
    figures(title, "streams", "reported", f"{len(outcome.streams) + 3 * len(PCS)}")
    for name, robot in outcome.robots.items():
        # Python's own start is part of it.
        figures(title, f"{name} has them all", "reported", f"{robot.found_s:.1f} s")
    figures(title, "LabRecorder has them all", "reported", f"{outcome.recorder_found_s:.1f} s")
    assert {stream.pc for stream in judged.streams} == set(PCS)


def test_nothing_is_lost_to_a_computer_that_was_cut_off(judged: Judged, figures: Record) -> None:
    before, after, _ = judged.outcome.moments.calm
    for receiver in judged.receivers:
        holes = judged.holes(receiver, before, after)
        lost = {s: hole for s, hole in holes.items() if hole and s.pc != KILLED}
        cut_off = sum(hole.missing for s, hole in lost.items() if s.pc == CUT_OFF)
        others = sum(hole.missing for s, hole in lost.items() if s.pc != CUT_OFF)
        what = _fault(judged, "a computer cut off for 6 s")
        figures(what, f"lost of its streams to {receiver}", "0", str(cut_off))
        figures(what, f"lost of others' streams to {receiver}", "0", str(others))
        assert not lost, (receiver, lost)


def test_of_a_killed_agent_only_the_time_of_its_death_is_missing(
    judged: Judged, figures: Record
) -> None:
    moments = judged.outcome.moments
    before, after, _ = moments.calm
    for receiver in judged.receivers:
        holes = judged.holes(receiver, before, after)
        found = {s: hole for s, hole in holes.items() if hole and s.pc == KILLED}
        longest_s = max((hole.end_s - hole.begin_s for hole in found.values()), default=0.0)
        what = _fault(judged, "an agent killed")
        figures(what, f"longest hole at {receiver}", "around its death", f"{longest_s:.1f} s")
        elsewhere = {s: h for s, h in found.items() if not _overlaps(h, moments.agent_dead)}
        assert not elsewhere, (receiver, moments.agent_dead, elsewhere)
    for robot in judged.outcome.robots.values():
        events = [rows for name, (_, _, rows) in robot.topics.items() if name.endswith("/events")]
        said = [json.loads(row[0]) for rows in events for row in rows]
        assert {each["last_end"] for each in said if each.get("restarts")} == {"killed by SIGKILL"}


def test_of_a_killed_node_only_the_time_of_its_death_is_missing(
    judged: Judged, figures: Record
) -> None:
    moments = judged.outcome.moments
    _, before, after = moments.calm
    what = _fault(judged, "a node killed")
    for receiver in judged.receivers:
        holes = {s: h for s, h in judged.holes(receiver, before, after).items() if h}
        figures(what, f"samples lost to {receiver}", "0, but to its own robot",
                str(sum(each.missing for each in holes.values())))  # fmt: skip
        if receiver == ROBOTS[1]:
            assert holes, "the node was not killed"
            holes = {s: h for s, h in holes.items() if not _overlaps(h, moments.node_dead)}
        assert not holes, (receiver, moments.node_dead, holes)


def test_the_nodes_count_no_loss_that_was_none(judged: Judged) -> None:
    """Nor does one hide a loss: what is missing elsewhere than around a death is zero, above."""
    before, after, last = judged.outcome.moments.calm
    for robot, spans in ((ROBOTS[0], (before, after, last)), (ROBOTS[1], (before, after))):
        for one, other in pairwise(spans):
            for stream in judged.streams:
                if stream.pc != KILLED:
                    assert judged.counted(robot, stream, one, other) == 0, (robot, stream)


def test_one_missing_sample_would_be_noticed(judged: Judged) -> None:
    """The proof is no stronger than what it would have found."""
    before, after, _ = judged.outcome.moments.calm
    topics = judged.outcome.robots[ROBOTS[0]].topics
    for stream in judged.streams:
        came = topics[stream.topic]
        middle = int(np.searchsorted(came.arrivals, (before.end + after.start) / 2))
        spoilt = Recording(*(np.delete(each, middle, axis=0) for each in came))
        truth = judged.outcome.truth[stream]
        try:
            found = hole(truth, spoilt, before, after)
        except ValueError:
            continue  # Two holes, as that of the killed agent is one already.
        assert found is not None, stream


def test_clocks_of_the_computers_are_measured(judged: Judged, figures: Record) -> None:
    """What LabRecorder measured, beside what the clocks of the namespaces are known to be apart."""
    errors = clock_errors_s(judged.outcome.xdf, judged.outcome.streams)
    for pc in PCS:
        median_ms, worst_ms = 1e3 * np.median(errors[pc]), 1e3 * np.max(np.abs(errors[pc]))
        text = f"{median_ms:.2f} ms median, {worst_ms:.2f} ms worst, of {len(errors[pc])}"
        figures(_fault(judged, "nothing yet"), f"error of the clock of {pc}", "reported", text)
        # Neither a second, by which namespaces differ at least, nor a computer is mistaken.
        assert worst_ms < 500.0


# What LabRecorder wrote in a lab of many computers.
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def recorded(path: Path, streams: Iterable[Stream]) -> dict[Stream, Recording]:
    """Return the numbers of each stream; the arrival of a sample is its stamp, in Unix time."""
    found = _by_stream(path, streams)
    return {
        each: _recording(each.pc, content)
        for each, content in found.items()
        if content["info"]["channel_format"] != ["string"]
    }


def clock_errors_s(path: Path, streams: Iterable[Stream]) -> dict[str, NDArray[np.float64]]:
    """Return by how much LabRecorder mismeasured the clock of each computer, all its streams."""
    errors: dict[str, list[float]] = {}
    for each, content in _by_stream(path, streams).items():
        true_s = CLOCK_OFFSETS_S[DESK] - CLOCK_OFFSETS_S[each.pc]
        errors.setdefault(each.pc, []).extend(v - true_s for v in content["clock_values"])
    return {pc: np.array(values) for pc, values in errors.items()}


def _by_stream(path: Path, streams: Iterable[Stream]) -> Mapping[Stream, Mapping[str, Any]]:
    contents, _ = _load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    ids = [content["info"]["source_id"][0] for content in contents]
    assert len(set(ids)) == len(ids), "a stream was recorded as two"
    by_id = dict(zip(ids, contents, strict=True))
    return {each: by_id[each.source_id] for each in streams}


def _recording(pc: str, content: Mapping[str, Any]) -> Recording:
    stamps = unix_s(pc, np.asarray(content["time_stamps"], np.float64))
    channels = int(content["info"]["channel_count"][0])
    rows = np.asarray(content["time_series"], np.float32).reshape(len(stamps), channels)
    return Recording(stamps, stamps, rows)
