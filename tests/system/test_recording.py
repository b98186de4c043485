"""A bag and an XDF file of the same run hold the same samples with the same stamps."""

from __future__ import annotations

import json
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity, StreamSpec
from biosensor_gateway.devices.registry import declaration
from tests.bags import made
from tests.system import bag_reader, lab_recorder, lsl_sources
from tests.system.bag_reader import RecordedTopic
from tests.system.lab_recorder import RecordedStream
from tests.system.programs import Program
from tests.system.tracks import (
    NS_PER_S,
    Errors,
    Track,
    place_of,
    system_minus_lsl_ns,
    time_errors,
    with_columns,
)
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

# A bag and an XDF file of the same run hold the same samples with the same times.

SHORTEST_S = 12.0
TIME_LIMIT_NS = 200_000
# Of a single measurement of a clock, however busy the computer is.
WORST_LIMIT_NS = 1_000_000
APART_SHARE = 0.05
# Noise of LabRecorder's measurements between two programs on one computer.
CLOCK_OFFSET_LIMIT_S = 0.002
# Only headsets with older firmware fill it.
EMPTY = "/biosensors/emotiv_insight/gyro_stamped"


@pytest.fixture(scope="module")
def run(workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return record(tmp_path_factory.mktemp("recording"), workspace)


def _pairs(run: RecordedRun) -> Iterator[tuple[str, Track, Track]]:
    """Yield topic, XDF and bag of the streams that have samples in the XDF file."""
    for topic, stream in run.streams.items():
        expected = stream.track
        if len(expected):
            assert topic in run.topics, f"{topic}: not in the bag"
            track = run.topics[topic].track
            is_list = track.values.dtype == object and expected.values.shape[1] > 1
            yield topic, expected, with_columns(track) if is_list else track


def test_both_have_every_stream(run: RecordedRun) -> None:
    every = declared()
    assert run.streams.keys() == in_xdf().keys()
    assert run.topics.keys() <= run.streams.keys() | run.pushed.keys()
    regular = {topic for topic, stream in every.items() if stream.is_regular} - {EMPTY}
    regular |= {spec.topic for spec in lsl_sources.SPECS if spec.is_regular}
    for topic in regular:
        times = run.topics[topic].track.times_ns
        assert times[-1] - times[0] >= SHORTEST_S * NS_PER_S, topic
    assert not len(run.streams[EMPTY].track)
    assert EMPTY not in run.topics


def test_every_sample_of_the_xdf_file_is_in_the_bag_once(run: RecordedRun) -> None:
    wrong = [topic for topic, xdf, bag in _pairs(run) if place_of(xdf, bag) is None]
    assert not wrong, f"values, order or number of samples differ: {wrong}"


def test_every_sample_of_the_bag_is_in_the_xdf_file_once(run: RecordedRun) -> None:
    begin, end = run.both_ns
    assert end - begin > 10 * NS_PER_S

    def are_in_both(topic: str) -> NDArray[np.bool_]:
        """Say of each message whether its sample was pushed while both recorded.

        One that came late may be of a time before that, and one that was measured then may
        have been pushed after it.
        """
        recorded = run.topics[topic]
        return (recorded.track.times_ns >= begin) & (recorded.arrivals_ns <= end)

    for topic, xdf, bag in _pairs(run):
        during = np.flatnonzero(are_in_both(topic))
        start = place_of(xdf, bag)
        assert start is not None, topic
        beyond = during[(during < start) | (during >= start + len(xdf))]
        assert not len(beyond), f"{topic}: {len(beyond)} samples are not in the XDF file"
    for topic, stream in run.streams.items():
        if not len(stream.track) and topic in run.topics:
            assert not are_in_both(topic).any(), topic


def _limit_ns(run: RecordedRun) -> float:
    """Return by how much a time may differ.

    A busy computer measures clocks badly, the node no worse than LabRecorder, whose
    offsets between two programs on one computer should all be zero.
    """
    offsets_s = np.abs(np.concatenate([each.clock_offsets for each in run.streams.values()]))
    noise_ns = 2 * float(np.percentile(offsets_s, 99)) * NS_PER_S
    return min(max(TIME_LIMIT_NS, noise_ns), WORST_LIMIT_NS)


def _check(run: RecordedRun, errors: Mapping[str, Errors]) -> None:
    """Assert that times differ by no more than clocks are measured badly.

    Where all probes of one of the node's measurements had to wait, a whole topic is off, and
    LabRecorder's offsets need not show it. So the limit holds for nearly all topics.
    """
    limit = _limit_ns(run)
    apart = {topic: each for topic, each in errors.items() if each.worst > limit}
    too_far = {topic: each for topic, each in apart.items() if each.worst > WORST_LIMIT_NS}
    assert not too_far, f"more than {WORST_LIMIT_NS / 1e3:.0f} us: {too_far}"
    assert len(apart) <= APART_SHARE * len(errors), f"more than {limit / 1e3:.0f} us: {apart}"
    assert np.mean([each.rms for each in errors.values()]) <= TIME_LIMIT_NS


def test_times_are_the_same(
    run: RecordedRun, record_property: Callable[[str, object], None]
) -> None:
    errors: dict[str, Errors] = {}
    for topic, xdf, bag in _pairs(run):
        start = place_of(xdf, bag)
        assert start is not None, topic
        errors[topic] = time_errors(bag.part(start, len(xdf)), xdf)
        worst, rms = (each / 1e3 for each in errors[topic])
        report = f"{len(xdf)} samples, worst {worst:.1f} us, RMS {rms:.1f} us"
        record_property(topic, report)
        print(f"{topic}: {report}")
    _check(run, errors)


def test_the_clocks_are_one(run: RecordedRun) -> None:
    """Why stamps are compared without the offsets that LabRecorder has measured."""
    for topic, stream in run.streams.items():
        offsets = np.abs(stream.clock_offsets)
        assert len(offsets) >= 2, topic
        assert np.median(offsets) < CLOCK_OFFSET_LIMIT_S, topic


def test_the_comparison_covers_every_kind_of_value(run: RecordedRun) -> None:
    pairs = {topic: xdf for topic, xdf, _ in _pairs(run)}
    missing = {
        topic
        for topic, xdf in pairs.items()
        if xdf.values.dtype == np.float64 and np.isnan(xdf.values).any()
    }
    assert "/biosensors/headset/EEG_stamped" in missing
    assert missing & declared().keys(), "no virtual device had a NaN"
    others = {spec.topic for spec in lsl_sources.SPECS} | {lsl_sources.BUTTON_TOPIC}
    assert others <= pairs.keys() | run.pushed.keys()
    channels = {xdf.values.shape[1] for xdf in pairs.values()}
    assert {1, 3, 8, 25} <= channels


def test_the_xdf_file_made_a_bag_is_what_was_recorded_live(
    run: RecordedRun, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    made.to_bag(run.xdf, tmp_path / "converted")
    converted = bag_reader.read(tmp_path / "converted")
    filled = {topic for topic, stream in run.streams.items() if len(stream.track)}
    assert converted.keys() == filled
    errors: dict[str, Errors] = {}
    for topic in filled:
        made_of_it, live = converted[topic], run.topics[topic]
        assert len(made_of_it.track) == len(run.streams[topic].track), topic
        start = place_of(made_of_it.track, live.track)
        assert start is not None, f"{topic}: values, order or number of samples differ"
        errors[topic] = time_errors(live.track.part(start, len(made_of_it.track)), made_of_it.track)
        told, published = (
            (each.track.labels, each.track.units, each.frame_ids) for each in (made_of_it, live)
        )
        assert told == published, topic
    worst_us = max(each.worst for each in errors.values()) / 1e3
    record_property("worst difference of a time in us", f"{worst_us:.1f}")
    _check(run, errors)


def test_integers_of_64_bits_are_exact(run: RecordedRun) -> None:
    """LabRecorder drops them, so the bag is compared with what was pushed."""
    begin, end = run.both_ns
    for topic, pushed in run.pushed.items():
        bag = run.topics[topic].track
        assert bag.values.dtype == np.int64
        start = place_of(bag, pushed)
        assert start is not None, topic
        during = np.flatnonzero((pushed.times_ns >= begin) & (pushed.times_ns <= end))
        assert start <= during[0] and during[-1] < start + len(bag)
        assert time_errors(pushed.part(start, len(bag)), bag).worst <= WORST_LIMIT_NS


def test_numbers_go_up_by_one(run: RecordedRun) -> None:
    for topic, recorded in run.topics.items():
        assert (np.diff(recorded.sequences) == 1).all(), topic


def test_channels_are_named_as_in_the_xdf_file(run: RecordedRun) -> None:
    for topic, xdf, bag in _pairs(run):
        if bag.values.dtype != object:
            assert (bag.labels, bag.units) == (xdf.labels, xdf.units), topic
        sensor = topic.rpartition("/")[0].replace("biosensors/", "")
        assert run.topics[topic].frame_ids == {sensor.removeprefix("/")}, topic


def test_the_bag_is_an_ordinary_one(run: RecordedRun, workspace: Workspace) -> None:
    """It has metadata, and the definitions and hashes of the messages that colcon has built."""
    metadata = (run.bag / "metadata.yaml").read_text()
    assert metadata.startswith("rosbag2_bagfile_information:")
    assert "\n  storage_identifier: mcap\n" in metadata
    package = workspace.install / "biosensor_msgs" / "share" / "biosensor_msgs" / "msg"
    with Reader(run.bag) as bag:
        assert [file.name for file in run.bag.glob("*.mcap")] == [run.bag.name + ".mcap"]
        assert {c.msgtype for c in bag.connections} == {
            "biosensor_msgs/msg/Event",
            "biosensor_msgs/msg/Samples",
        }
        assert sum(1 for _ in bag.messages()) == bag.message_count
        for connection in bag.connections:
            name = connection.msgtype.rpartition("/")[2]
            built = json.loads((package / f"{name}.json").read_text())["type_hashes"]
            (expected,) = (
                each["hash_string"] for each in built if each["type_name"] == connection.msgtype
            )
            assert connection.digest == expected
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            assert store.hash_rihs01(connection.msgtype) == expected


# One run of the whole chain that two programs record: a bag, and LabRecorder's XDF file.
RECORD_S = 14.0
DEADLINE_S = 90.0
# The node looks for subscribers four times a second.
SUBSCRIBED_S = 1.0
# What comes shortly after LabRecorder has opened its streams may have been pushed before.
# It pulls twice a second, and what comes after its last pull is not in the file.
BEGIN_MARGIN_S = 1.0
END_MARGIN_S = 1.5
SENSORS = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
    "ble_heart_rate",
)
_UNIT = "virtual"
# LabRecorder drops streams of 64-bit integers.
NOT_IN_XDF = tuple(spec for spec in lsl_sources.SPECS if spec.format == "int64")


@dataclass(frozen=True)
class RecordedRun:
    """What was recorded."""

    # bag, xdf: the two files.
    bag: Path
    xdf: Path
    # topics, streams: by the name of the stamped topic: what the bag has, and what LabRecorder has.
    topics: Mapping[str, RecordedTopic]
    streams: Mapping[str, RecordedStream]
    # All that the test itself has pushed of the streams that LabRecorder drops.
    pushed: Mapping[str, Track]
    both_ns: tuple[int, int]  # System times between which both recorded for certain.


def declared() -> dict[str, StreamSpec]:
    """Return the streams of the virtual devices by their stamped topics."""
    return {
        f"/{naming.topic(DeviceIdentity(name, _UNIT), stream.data_name)}_stamped": stream
        for name in SENSORS
        for stream in declaration(name).streams
    }


def in_xdf() -> dict[str, str]:
    """Return the ``source_id`` of each stream that LabRecorder records, by stamped topic."""
    devices = {
        topic: naming.source_id(DeviceIdentity(topic.split("/")[-2], _UNIT), stream.data_name)
        for topic, stream in declared().items()
    }
    others = {spec.topic: spec.source_id for spec in lsl_sources.SPECS if spec not in NOT_IN_XDF}
    gateway = DeviceIdentity("gateway", socket.gethostname())
    agent = {
        f"/biosensors/gateway/{name}_stamped": naming.source_id(gateway, name)
        for name in ("events", "markers")
    }
    return devices | others | agent | {lsl_sources.BUTTON_TOPIC: lsl_sources.BUTTON_SOURCE_ID}


def record(folder: Path, workspace: Workspace) -> RecordedRun:
    """Run agent, other programs, node and both recorders, and read what they wrote.

    Raises
    ------
    AssertionError
        If a stamped topic does not appear, or a program fails; with what they said.
    """
    bag, xdf = folder / "bag", folder / "run.xdf"
    with ExitStack() as stack:
        programs = _Programs(folder, workspace, stack)
        node = programs.start("node", workspace.node)
        package = workspace.install / "biosensor_msgs" / "share" / "biosensor_msgs"
        # The tests' own interpreter has rosbags, and the messages come from the workspace.
        listening = (sys.executable, "-m", "tests.system.bag_recorder", str(bag), str(package))
        recorder = programs.start("recorder", *listening)
        agent_program = (sys.executable, "-m", "biosensor_gateway.cli", "run")
        running = (*agent_program, "--simulate", ",".join(SENSORS))
        agent = programs.start("agent", *running, is_ros=False)
        sources = stack.enter_context(lsl_sources.running())
        _wait_for_topics(recorder, {*in_xdf(), *(spec.topic for spec in NOT_IN_XDF)}, node)
        time.sleep(SUBSCRIBED_S)
        with lab_recorder.recording(xdf, in_xdf().values()):
            begin_ns = time.time_ns() + round(BEGIN_MARGIN_S * NS_PER_S)
            time.sleep(RECORD_S)
            end_ns = time.time_ns() - round(END_MARGIN_S * NS_PER_S)
        offset_ns = system_minus_lsl_ns()
        _end(recorder, signal.SIGTERM)
        _end(node, signal.SIGINT)
        _end(agent, signal.SIGINT)
    dropped = [source for source in sources if source.spec in NOT_IN_XDF]
    return RecordedRun(
        bag,
        xdf,
        topics=bag_reader.read(bag),
        streams=lab_recorder.read(xdf, offset_ns),
        pushed={source.spec.topic: source.track(offset_ns) for source in dropped},
        both_ns=(begin_ns, end_ns),
    )


class _Programs:
    """Starts programs that end with a block, at the latest."""

    def __init__(self, folder: Path, workspace: Workspace, stack: ExitStack) -> None:
        self._folder = folder
        self._environment = workspace.environment()
        self._stack = stack

    def start(self, name: str, *command: str, is_ros: bool = True) -> Program:
        """Start a program, in the environment of the workspace if it is one of ROS."""
        environment = self._environment if is_ros else None
        program = Program(command, self._folder / f"{name}.log", env=environment)
        self._stack.callback(program.end)
        return program


def _end(program: Program, number: signal.Signals) -> None:
    """End a program by a signal, cleanly."""
    program.process.send_signal(number)
    assert program.process.wait(DEADLINE_S) == 0, program.output


def _wait_for_topics(recorder: Program, topics: set[str], node: Program) -> None:
    """Wait until the recorder receives all topics, or for the deadline."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        missing = topics - {record.get("matched") for record in recorder.records}
        if not missing:
            return
        said = f"{recorder.output}{node.output}"
        assert time.monotonic() < deadline, f"no topic {sorted(missing)}:\n{said}"
        time.sleep(0.1)
