"""Agent, node and a robot on two computers, each a set of namespaces, joined by a cable."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pytest
import pyxdf

from biosensor_common.ros_clock import NS_PER_S
from tests.faults.expectations import steady_streams
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import MARGIN_S, Recording, Span, delays
from tests.rigs.hosts.lan import Lan
from tests.rigs.hosts.pair import SENSORS, Observation, Pair, Place, Places
from tests.rigs.hosts.programs import Program, SteeredProgram
from tests.rigs.hosts.subscriber import BEST_EFFORT
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.robot import PARTS, UNWRITTEN_S, Stream, greatest_errors_s, told_lost
from tests.rigs.turns import turn_of, turns

pytestmark = pytest.mark.system

# Agent and node on two computers, each a set of namespaces, joined by a switch.

# How far ahead each computer's monotonic clock is; nobody boots two at the same time.
CLOCK_OFFSETS_S = {"agent-pc": 86_400, "robot": 0}
WITH_DESK_S = {**CLOCK_OFFSETS_S, "desk": 3_600}
SECONDS = 60.0
# Longer than LSL's resolver remembers what it does not see, which is 5 s in the node.
CUT_S = 6.0
# TCP tries again after 6.3 s, and after 12.7 s where it had begun early.
HEALED_S = 10.0
LOSS_PERCENT = 5
LOSS_S = 20.0
# A packet, what asks for it again and its repetition may all be lost.
REPAIRED_S = 12.0
CALM_S = 8.0
# The first chunk holds samples of the four seconds before it.
LEAD_S = MARGIN_S + 4.0
DEADLINE_S = 60.0
TURNS = turns(SENSORS)
ECG, ECG_SOURCE = "/biosensors/zephyr/ecg", "zephyr-virtual-ecg"
COUNTERS = "/biosensors/gateway/counters"
STAMPED = "/biosensors/empatica_e4/st_temperature"
STAMPED_SAMPLES = 40
Report = Callable[[str, object], None]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Isolated by the namespaces; the session only tells that the settings take effect."""
    config = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    config.write_text(f"[lab]\nSessionID = two-hosts-{uuid.uuid4().hex}\n")
    return {**os.environ, "LSLAPICFG": str(config), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


class Crossing(NamedTuple):
    """What was observed while all was well, then over a cut cable."""

    sensors: tuple[str, ...]
    observation: Observation
    expected: dict[str, Place]
    node_log: str
    minute: Span
    cut: Span
    calm: tuple[Span, Span]


@pytest.fixture(scope="module", params=TURNS, ids="+".join)
def crossing(
    request: pytest.FixtureRequest,
    environment: dict[str, str],
    tmp_path_factory: pytest.TempPathFactory,
) -> Crossing:
    sensors: tuple[str, ...] = request.param
    places = Places(agent="agent-pc", node="robot", subscriber="robot", receiver="agent-pc")
    folder = tmp_path_factory.mktemp("crossing")
    with (
        Lan(CLOCK_OFFSETS_S) as lan,
        Pair(lan, places, environment, folder, sensors=sensors) as pair,
    ):
        pair.await_matched()
        begin = time.time() + LEAD_S
        minute = Span(begin, begin + SECONDS)
        _sleep_until(minute.end + MARGIN_S)
        lan.unplug("agent-pc")
        time.sleep(CUT_S)
        lan.plug_in("agent-pc")
        healed = time.time() + HEALED_S
        cut = Span(minute.end - CALM_S, healed + CALM_S)
        _sleep_until(cut.end + 2 * MARGIN_S)
        observation, node_log = pair.observe(), pair.node.log
    calm = (Span(cut.start, minute.end), Span(healed, cut.end))
    return Crossing(sensors, observation, pair.expected, node_log, minute, cut, calm)


def _sleep_until(time_s: float) -> None:
    time.sleep(max(0.0, time_s - time.time()))


@pytest.mark.timeout(400)
def test_the_whole_set_of_sensors_crosses_without_a_loss(crossing: Crossing) -> None:
    observation, minute = crossing.observation, crossing.minute
    faults = observation.faults(crossing.expected, minute, [minute])
    assert not faults, json.dumps(faults, indent=1)


@pytest.mark.timeout(400)
def test_the_agent_and_another_lsl_program_agree(crossing: Crossing) -> None:
    observation = crossing.observation
    reports, streams = observation.counters, observation.streams
    assert completeness.differences(reports, streams, crossing.minute) == {}


@pytest.mark.timeout(400)
def test_the_node_knows_of_no_loss(crossing: Crossing) -> None:
    begin = crossing.observation.facts_at(crossing.minute.start)
    end = crossing.observation.facts_at(crossing.minute.end)
    for place in crossing.expected.values():
        before, after = begin[place.topic]["lost"], end[place.topic]["lost"]
        assert after in {before, "0"}, f"{place.topic}: lost {before}, then {after}"
        if after == "unknown":
            # The counters do not count themselves, and one sample alone cannot be settled.
            is_counted = place.topic != COUNTERS and int(end[place.topic]["received"]) > 1
            assert not is_counted, f"{place.topic}: the node does not know what was lost"


@pytest.mark.timeout(400)
def test_the_cut_network_heals_with_its_backlog(
    crossing: Crossing, record_property: Report
) -> None:
    observation, cut = crossing.observation, crossing.cut
    pauses_s = {
        topic: float(np.diff(observation.topics[topic].between(*cut).arrivals).max())
        for name in crossing.sensors
        for topic in (f"/biosensors/{name}/{each}" for each in steady_streams(name))
    }
    record_property("longest pause of each steady topic, in s", pauses_s)
    assert min(pauses_s.values()) > CUT_S - 1.0, f"the cable was not cut: {pauses_s}"
    faults = observation.faults_in_bad_weather(crossing.expected, cut, crossing.calm)
    assert not faults, json.dumps(faults, indent=1)


@pytest.mark.timeout(400)
def test_the_node_kept_every_inlet_and_lost_nothing_with_the_cut(crossing: Crossing) -> None:
    assert "is gone" not in crossing.node_log
    facts = crossing.observation.facts_at(crossing.cut.end)
    by_devices = completeness.lost_by_devices(
        crossing.observation.counters, crossing.cut.end + MARGIN_S
    )
    for source, place in crossing.expected.items():
        lost = facts[place.topic]["lost"]
        assert lost == "unknown" or int(lost) <= by_devices.get(source, 0), place.topic


@pytest.mark.timeout(400)
def test_one_missing_message_would_be_noticed(crossing: Crossing) -> None:
    """The proof is no stronger than what it would have found."""
    observation, minute = crossing.observation, crossing.minute
    spoilt = {
        topic: _without_one(recording, minute) for topic, recording in observation.topics.items()
    }
    faults = observation._replace(topics=spoilt).faults(crossing.expected, minute, [minute])
    several = {
        topic
        for place in crossing.expected.values()
        for topic in place.topics
        if len(np.unique(observation.topics[topic].between(*minute).arrivals)) > 2
    }
    assert len(several) > len(crossing.expected) / 2
    assert set(faults) >= several


def _without_one(recording: Recording, span: Span) -> Recording:
    """Leave out the message in the middle of a time."""
    came = np.unique(recording.between(*span).arrivals)
    left = recording.arrivals != (came[len(came) // 2] if len(came) else 0.0)
    return Recording(recording.arrivals[left], recording.stamps[left], recording.rows[left])


@pytest.mark.timeout(400)
def test_nothing_is_lost_to_a_reliable_subscriber_on_a_lossy_network(
    environment: dict[str, str], tmp_path: Path, record_property: Report
) -> None:
    """LSL from agent to node and DDS from node to subscriber, each between two computers."""
    places = Places(agent="agent-pc", node="robot", subscriber="desk", receiver="agent-pc")
    # What a network does to streams is no matter of sensors, so one turn is enough.
    sensors = turn_of("zephyr", TURNS)
    with (
        Lan(WITH_DESK_S) as lan,
        Pair(lan, places, environment, tmp_path, ECG, sensors=sensors) as pair,
    ):
        pair.await_matched()
        begin = time.time() + LEAD_S
        _sleep_until(begin + CALM_S)
        lan.lose(LOSS_PERCENT)
        lossy = Span(begin + CALM_S, begin + CALM_S + LOSS_S)
        _sleep_until(lossy.end)
        dropped = lan.lose_nothing()
        repaired = time.time() + REPAIRED_S
        required = Span(begin, repaired + CALM_S)
        _sleep_until(required.end + 2 * MARGIN_S)
        observation = pair.observe()
    record_property("packets lost", dropped)
    record_property("delay", _delay(observation, lossy))
    assert all(count > 100 for count in dropped.values()), dropped
    sent = len(observation.streams[ECG_SOURCE].between(*lossy).rows)
    came = len(observation.topics[ECG + BEST_EFFORT].between(*lossy).rows)
    record_property("ECG samples that came best effort", f"{came} of {sent}")
    assert came < sent, "the network has lost nothing"
    calm = [Span(begin, lossy.start), Span(repaired, required.end)]
    faults = observation.faults_in_bad_weather(pair.expected, required, calm)
    assert not faults, json.dumps(faults, indent=1)


def _delay(observation: Observation, span: Span) -> str:
    """How much later the ECG came to the subscriber than to the agent's own computer."""
    reference = observation.streams[ECG_SOURCE]
    try:
        late = delays(reference, observation.topics[ECG].between(*span))
    except ValueError as error:
        return str(error)
    p50, p99 = np.percentile(late, [50, 99])
    return f"p50 {1000 * p50:.0f} ms, p99 {1000 * p99:.0f} ms, max {1000 * late.max():.0f} ms"


@pytest.mark.timeout(400)
@pytest.mark.alone
@pytest.mark.parametrize(
    ("sender_host", "limit_s"), [("robot", 0.0002), ("agent-pc", 0.001)], ids=["one", "two"]
)
def test_stamps_are_the_true_times(
    environment: dict[str, str],
    tmp_path: Path,
    record_property: Report,
    sender_host: str,
    limit_s: float,
) -> None:
    """On one computer and on two: the ROS time of a sample is when it was measured."""
    with (
        Lan(CLOCK_OFFSETS_S) as lan,
        SteeredProgram(lan["robot"], environment, tmp_path, _rig("subscriber")) as subscriber,
        Program(lan["robot"], environment, tmp_path, "lsl_to_ros.node"),
        SteeredProgram(lan[sender_host], environment, tmp_path, _rig("sender")) as sender,
    ):
        recording = _recorded(subscriber, tmp_path)
        true_ns = np.array(sender.ask("sent"))
    numbers = recording.rows[:, 0].astype(int)
    assert (np.diff(numbers) == 1).all()
    errors_us = (recording.stamps - true_ns[numbers]) / 1000.0
    worst, rms = np.abs(errors_us).max(), np.sqrt(np.mean(errors_us**2))
    record_property("stamp error in us", f"worst {worst:.1f}, RMS {rms:.1f}")
    assert worst <= limit_s * 1e6, errors_us


def _rig(name: str) -> str:
    return f"tests.rigs.hosts.{name}"


def _recorded(subscriber: SteeredProgram, folder: Path) -> Recording:
    """Wait for so many stamped messages and fetch them."""
    end = time.monotonic() + DEADLINE_S
    while subscriber.ask("state")["received"].get(STAMPED, 0) < STAMPED_SAMPLES:
        assert time.monotonic() < end, f"too few messages on {STAMPED}"
        time.sleep(0.5)
    path = folder / "topics.npz"
    subscriber.ask("save", path=str(path))
    return completeness.load(path)[STAMPED]


@pytest.mark.timeout(400)
def test_where_no_computers_can_be_made_it_is_said_and_not_passed_over() -> None:
    # Without capabilities root is nobody.
    powerless = ["setpriv", "--inh-caps", "-all", "--bounding-set", "-all"]
    enter = "from tests.rigs.hosts.lan import Lan; Lan({'here': 0}).__enter__()"
    tried = subprocess.run(
        [*powerless, sys.executable, "-c", enter],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert tried.returncode != 0
    assert "computers cannot be made of namespaces here" in tried.stderr
    assert "run this test as root" in tried.stderr


# A robot and ``ros_to_lsl`` on one computer, LabRecorder on another one.
RECORDER_AHEAD_S = 3_600
# LabRecorder asks for the clocks' offset every five seconds.
RECORD_S = 8.0
STAMP_LIMIT_S = 0.002
# The node's events are a stream, too.
STREAMS = len(PARTS) + 1
_load_xdf: Callable[..., tuple[list[Stream], Stream]] = cast("Any", pyxdf).load_xdf


@pytest.mark.timeout(200)
@pytest.mark.alone
def test_stamps_are_those_that_were_published_on_the_other_computer(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    config = tmp_path / "lsl_api.cfg"
    config.write_text("[lab]\nSessionID = robot-two-hosts\n")
    environment = {
        **os.environ,
        "LSLAPICFG": str(config),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    }
    sent, study = tmp_path / "sent.json", tmp_path / "study.xdf"
    topics = ("-p", f"topics:=[{', '.join(each.topic for each in PARTS)}]")
    with Lan({"robot": 0, "lab": RECORDER_AHEAD_S}) as lan:
        robot = lan["robot"]
        node = Program(
            robot, environment, tmp_path, "lsl_to_ros.ros_to_lsl.node", "--ros-args", *topics
        )
        with (
            node,
            Program(robot, environment, tmp_path, "tests.rigs.robot", str(sent)),
            LabRecorder(study, at_least=STREAMS, computer=lan["lab"], environment=environment),
        ):
            begun_ns = time.time_ns()
            time.sleep(RECORD_S)
            ended_ns = time.time_ns()
    # The recording's clock is the monotonic one of the recorder's computer.
    offset_s = time.time() - (time.monotonic() + RECORDER_AHEAD_S)
    streams, _ = _load_xdf(str(study))
    by_name = {each["info"]["name"][0]: each for each in streams}
    span = begun_ns, ended_ns - round(UNWRITTEN_S * NS_PER_S)
    published = json.loads(sent.read_text())
    worst_s = greatest_errors_s(by_name, published, span, offset_s, told_lost(node.log))
    record_property("stamp error in us", {t: round(s * 1e6) for t, s in worst_s.items()})
    assert max(worst_s.values()) < STAMP_LIMIT_S, worst_s
