"""The cable between the two computers is pulled for 5, 30 and, in a long run, 120 s.

Agent and node are on two computers made of namespaces; only the network joins them. An
LSL program on the agent's computer has all that was sent, a subscriber on the node's all
that was published.

TCP keeps what it could not send, and so nothing is lost as long as it tries again soon:
6.3 s after the cut, or 12.7 s. After a longer cut the next try may be a minute away. The
node then does not wait for it but attaches again, and counts what that costs.
"""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Mapping
from typing import NamedTuple

import pytest

from biosensor_gateway.devices.registry import declaration
from tests.faults.scenarios.figures import Record, is_long
from tests.faults.scenarios.holes import missing
from tests.rigs.hosts.completeness import MARGIN_S, Recording, Span
from tests.rigs.hosts.lan import Lan
from tests.rigs.hosts.pair import Observation, Pair, Place, Places

pytestmark = [pytest.mark.system, pytest.mark.timeout(500)]

CLOCK_OFFSETS_S = {"agent-pc": 86_400, "robot": 0}
# The agent's computer does not see that its packets go nowhere, as it would with its own cable.
CUT_OFF = "robot"
SENSORS = ("zephyr", "empatica_e4")
SHORT_S = 5.0
CUTS_S = (SHORT_S, 30.0, *((120.0,) if is_long() else ()))
# The first chunk holds samples of the four seconds before it.
LEAD_S = MARGIN_S + 4.0
CALM_S = 4.0
FLOWS_WITHIN_S = 10.0
DETECTED_WITHIN_S = 2.0
# The diagnostics come once a second; a busy machine may be late by one of them.
BUSY_S = 1.0
# There the programs have five seconds of backlog to work off, too.
FLOWS_BUSY_S = 5.0
DEADLINE_S = 30.0
_OK = "00"

EVERY_CUT = pytest.mark.parametrize("seconds", CUTS_S, ids=[f"{each:g} s" for each in CUTS_S])
LONGER_CUTS = pytest.mark.parametrize(
    "seconds", CUTS_S[1:], ids=[f"{each:g} s" for each in CUTS_S[1:]]
)


class Cut(NamedTuple):
    """Unix times of what happened to the cable."""

    # begin_s, pulled_s: right before it was pulled, and when it was out for certain.
    begin_s: float
    pulled_s: float
    # healed_s, end_s: when it was back, and the end of the calm then.
    healed_s: float
    end_s: float

    @property
    def before(self) -> Span:
        return Span(self.begin_s - CALM_S, self.begin_s - 0.5)

    @property
    def after(self) -> Span:
        return Span(self.end_s - CALM_S, self.end_s)


class Crossing(NamedTuple):
    """What was observed."""

    observation: Observation
    expected: Mapping[str, Place]
    cuts: Mapping[float, Cut]
    node_log: str

    def regular(self) -> dict[str, Recording]:
        """Return what came of each stream that has a rate, by source_id."""
        topics = {
            f"/biosensors/{name}/{stream.data_name}"
            for name in SENSORS
            for stream in declaration(name).streams
            if stream.rate
        }
        places = {s: place.topic for s, place in self.expected.items() if place.topic in topics}
        return {source: self.observation.topics[topic] for source, topic in places.items()}

    def flowed_after_s(self, cut: Cut) -> float:
        """Seconds from the healing until every regular stream had a sample again."""
        arrivals = [each.arrivals for each in self.regular().values()]
        return max(float(each[each >= cut.healed_s].min()) for each in arrivals) - cut.healed_s

    def detected_after_s(self, cut: Cut) -> float:
        """Seconds from the cut until the diagnostics said of every regular stream that it ails.

        They may say so before the program that pulls the cable has ended: that is at once.
        """
        topics = [self.expected[source].topic for source in self.regular()]
        said_s = next(
            came_s
            for came_s, facts in self.observation.diagnostics
            if came_s > cut.begin_s and all(facts[topic]["level"] != _OK for topic in topics)
        )
        return max(0.0, said_s - cut.pulled_s)

    def missing(self, cut: Cut) -> dict[str, int]:
        """Count by source_id what was sent and not published."""
        streams = self.observation.streams
        counts = {
            source: missing(streams[source], came, cut.before, cut.after)
            for source, came in self.regular().items()
        }
        assert None not in counts.values(), counts
        return {source: count for source, count in counts.items() if count is not None}

    def counted(self, cut: Cut) -> dict[str, int]:
        """What the node counted as lost, by source_id."""
        before = self.observation.facts_at(cut.before.start)
        after = self.observation.facts_at(cut.after.end)
        return {
            source: int(after[topic]["lost"]) - int(before[topic]["lost"])
            for source in self.regular()
            for topic in [self.expected[source].topic]
        }


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Crossing:
    folder = tmp_path_factory.mktemp("crossing")
    config = folder / "lsl_api.cfg"
    config.write_text(f"[lab]\nSessionID = cut-{uuid.uuid4().hex}\n")
    scope = {"LSLAPICFG": str(config), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    places = Places(agent="agent-pc", node="robot", subscriber="robot", receiver="agent-pc")
    with (
        Lan(CLOCK_OFFSETS_S) as lan,
        Pair(lan, places, {**os.environ, **scope}, folder, sensors=SENSORS) as pair,
    ):
        pair.await_matched()
        time.sleep(LEAD_S)
        cuts = {seconds: _cut(lan, seconds) for seconds in CUTS_S}
        time.sleep(MARGIN_S)
        observation = _observe(pair, max(cut.end_s for cut in cuts.values()))
        return Crossing(observation, pair.expected, cuts, pair.node.log)


def _observe(pair: Pair, time_s: float) -> Observation:
    """Look once the diagnostics have come that say how things were at a time."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        observation = pair.observe()
        if any(came_s >= time_s for came_s, _ in observation.diagnostics):
            return observation
        assert time.monotonic() < deadline, f"no diagnostics come: {pair.node.last_words}"
        time.sleep(BUSY_S)


def _cut(lan: Lan, seconds: float) -> Cut:
    time.sleep(CALM_S)
    begin_s = time.time()
    lan.unplug(CUT_OFF)
    pulled_s = time.time()
    time.sleep(seconds)
    lan.plug_in(CUT_OFF)
    healed_s = time.time()
    time.sleep(FLOWS_WITHIN_S + FLOWS_BUSY_S + CALM_S)
    return Cut(begin_s, pulled_s, healed_s, time.time())


def _fault(seconds: float) -> str:
    return f"network between the hosts cut for {seconds:g} s"


@EVERY_CUT
def test_the_samples_flow_again_soon_after_healing(
    crossing: Crossing, figures: Record, seconds: float
) -> None:
    after_s = crossing.flowed_after_s(crossing.cuts[seconds])
    figures(_fault(seconds), "flow resumes after healing", "≤ 10 s", f"{after_s:.1f} s")
    assert after_s <= FLOWS_WITHIN_S + FLOWS_BUSY_S


@EVERY_CUT
def test_the_diagnostics_say_so(crossing: Crossing, figures: Record, seconds: float) -> None:
    after_s = crossing.detected_after_s(crossing.cuts[seconds])
    figures(_fault(seconds), "/diagnostics say so after", "≤ 2 s", f"{after_s:.1f} s")
    assert after_s <= DETECTED_WITHIN_S + BUSY_S


def test_nothing_is_lost_to_a_short_cut(crossing: Crossing, figures: Record) -> None:
    cut = crossing.cuts[SHORT_S]
    lost = crossing.missing(cut)
    figures(_fault(SHORT_S), "samples lost", "0", str(sum(lost.values())))
    assert not any(lost.values()), lost
    calm = [cut.before, cut.after]
    span = Span(cut.before.start, cut.after.end)
    observation = crossing.observation
    assert not observation.faults_in_bad_weather(crossing.expected, span, calm)


@LONGER_CUTS
def test_what_a_longer_cut_costs_is_counted_and_announced(
    crossing: Crossing, figures: Record, seconds: float
) -> None:
    cut = crossing.cuts[seconds]
    lost, counted = crossing.missing(cut), crossing.counted(cut)
    text = f"{sum(counted.values())} of {sum(lost.values())}"
    figures(_fault(seconds), "samples lost, counted exactly", "all", text)
    assert counted == lost
    for topic in (crossing.expected[source].topic for source, count in lost.items() if count):
        facts = [facts.get(topic, {}) for _, facts in crossing.observation.diagnostics]
        assert any("samples lost" in each.get("message", "") for each in facts), topic
