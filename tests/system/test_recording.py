"""A bag and an XDF file of the same run hold the same samples with the same times.

The agent runs virtual devices of seven kinds, other programs send in every format, the
node is the one that colcon has installed, and the real LabRecorder records beside a
recorder of the stamped topics.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.bags import made
from tests.system import bag_reader, lsl_sources, recorded_run
from tests.system.lsl_time import NS_PER_S
from tests.system.recorded_run import RecordedRun
from tests.system.tracks import Errors, Track, place_of, time_errors, with_columns
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

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
    return recorded_run.record(tmp_path_factory.mktemp("recording"), workspace)


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
    declared = recorded_run.declared()
    assert run.streams.keys() == recorded_run.in_xdf().keys()
    assert run.topics.keys() <= run.streams.keys() | run.pushed.keys()
    regular = {topic for topic, stream in declared.items() if stream.is_regular} - {EMPTY}
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
    assert missing & recorded_run.declared().keys(), "no virtual device had a NaN"
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
