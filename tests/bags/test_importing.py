"""Bags of others: what becomes of their topics, however odd, and what is said of what."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from typer.testing import CliRunner

from biosensor_gateway.cli.bag import app
from biosensor_gateway.recording.bag.conversion import Imported, import_bag
from biosensor_gateway.recording.bag.headers import TOPIC, RecordedStream, listed_facts, stream_text
from biosensor_gateway.recording.bag.types import EVENT, SAMPLES, BagError, BagReason
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.marker_events import markers
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import judge
from tests.bags import made, mcap_bytes
from tests.xdf.checking import load_by_pyxdf

# Bags of others: what becomes of their topics, and what is said of what cannot be read.

BEGIN_NS = 1_790_000_000_000_000_000
STORE = made.typestore()
TYPES = STORE.types


def _header(unix_ns: int, frame_id: str = "base") -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(unix_ns, 10**9))
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)


def _joints(
    number: int, names: tuple[str, ...] = ("shoulder", "elbow"), *, moves: bool = False
) -> Any:
    count = len(names)
    return TYPES["sensor_msgs/msg/JointState"](
        header=_header(BEGIN_NS + number * 10_000_000),
        name=list(names),
        position=np.arange(count) + number / 3,
        velocity=np.zeros(count) if moves else np.empty(0),
        effort=np.empty(0),
    )


def _robot(count: int = 200) -> list[tuple[str, str, int, Any]]:
    messages: list[tuple[str, str, int, Any]] = []
    float64 = TYPES["std_msgs/msg/Float64"]
    for number in range(count):
        # It arrives 3 ms after it was measured.
        at_ns = BEGIN_NS + number * 10_000_000 + 3_000_000
        messages.append(("/joint_states", "sensor_msgs/msg/JointState", at_ns, _joints(number)))
        messages.append(("/load", "std_msgs/msg/Float64", at_ns, float64(number / 7)))
    said = TYPES["std_msgs/msg/String"]("trial \u00e4 \U0001f9e0")
    messages.append(("/said", "std_msgs/msg/String", BEGIN_NS + 10**9, said))
    pixels = TYPES["sensor_msgs/msg/CompressedImage"](
        header=_header(BEGIN_NS), format="png", data=np.zeros(50, np.uint8)
    )
    messages.append(("/camera", "sensor_msgs/msg/CompressedImage", BEGIN_NS, pixels))
    return sorted(messages, key=lambda each: each[2])


@pytest.mark.parametrize("storage", StoragePlugin)
def test_any_numbers_become_channels(tmp_path: Path, storage: StoragePlugin) -> None:
    made.write_bag(tmp_path / "robot", _robot(), storage)
    imported = import_bag(tmp_path / "robot", tmp_path / "robot.xdf")
    assert dict(imported.streams) == {"/joint_states": 200, "/load": 200, "/said": 1}
    assert imported.left_out == {"/camera": "its field data holds images or the like, not numbers"}
    assert not imported.damages
    joints, load, said = load_by_pyxdf(tmp_path / "robot.xdf")
    assert joints["info"]["name"] == ["joint_states"]
    labels = [each["label"][0] for each in joints["info"]["desc"][0]["channels"][0]["channel"]]
    assert labels == ["shoulder.position", "elbow.position"]
    np.testing.assert_array_equal(joints["time_series"][:, 1], 1 + np.arange(200) / 3)
    # By the stamp in the message, to the step of a float of today's seconds.
    expected = BEGIN_NS / 1e9 + np.arange(200) / 100
    np.testing.assert_allclose(joints["time_stamps"], expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(load["time_stamps"], expected + 0.003, rtol=0, atol=1e-6)
    assert load["time_series"][3, 0] == 3 / 7
    assert said["time_series"] == [["trial \u00e4 \U0001f9e0"]]


def test_another_shape_is_another_stream(tmp_path: Path) -> None:
    messages = [
        ("/joints", "sensor_msgs/msg/JointState", BEGIN_NS + n, _joints(1, names, moves=True))
        for n, names in enumerate([("a", "b"), ("a", "b", "c"), ("a", "b")])
    ]
    made.write_bag(tmp_path / "robot", messages)
    import_bag(tmp_path / "robot", tmp_path / "robot.xdf")
    two, three = made.held(tmp_path / "robot.xdf")
    assert [len(two.stamps), len(three.stamps)] == [2, 1]
    assert np.asarray(three.values).shape == (1, 6)
    assert np.asarray(two.values)[1].tolist() == [1 / 3, 4 / 3, 0.0, 0.0]


def test_times_and_nested_messages_are_flattened(tmp_path: Path) -> None:
    pose = TYPES["geometry_msgs/msg/Pose"](
        TYPES["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    poses = TYPES["geometry_msgs/msg/PoseArray"](_header(0), [pose, pose])
    made.write_bag(tmp_path / "a", [("/poses", "geometry_msgs/msg/PoseArray", BEGIN_NS, poses)])
    import_bag(tmp_path / "a", tmp_path / "a.xdf")
    with open_contents(tmp_path / "a.xdf") as contents:
        (stream,) = contents.streams
        labels, units = stream.header.labels, stream.meaning.units
        (samples,) = stream.blocks()
    assert labels[:4] == (
        "poses[0].position.x",
        "poses[0].position.y",
        "poses[0].position.z",
        "poses[0].orientation.x",
    )
    assert labels[-1] == "poses[1].orientation.w"
    assert units == ("m", "m", "m", "none", "none", "none", "none") * 2
    assert np.asarray(samples.values)[0, -7:].tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    # A stamp of zero is none.
    assert samples.times[0] == pytest.approx(BEGIN_NS / 1e9)


def test_points_of_a_trajectory_are_no_joints(tmp_path: Path) -> None:
    duration = TYPES["builtin_interfaces/msg/Duration"](2, 500_000_000)
    empty = np.empty(0)
    point = TYPES["trajectory_msgs/msg/JointTrajectoryPoint"](
        np.array([0.5, 1.5]), empty, empty, empty, duration
    )
    kind = "trajectory_msgs/msg/JointTrajectory"
    path = TYPES[kind](_header(0), ["a", "b"], [point, point])
    made.write_bag(tmp_path / "a", [("/path", kind, BEGIN_NS, path)])
    import_bag(tmp_path / "a", tmp_path / "a.xdf")
    with open_contents(tmp_path / "a.xdf") as contents:
        (stream,) = contents.streams
    last = ("points[1].positions[0]", "points[1].positions[1]", "points[1].time_from_start")
    assert stream.header.labels[3:] == last
    assert stream.meaning.units[3:] == ("", "", "s")


def _live(topic: str, count: int) -> list[tuple[str, str, int, Any]]:
    """What a node publishes of a stream of ours: raw, stamped, and a chunk."""
    messages: list[tuple[str, str, int, Any]] = []
    float32 = TYPES["std_msgs/msg/Float32"]
    for number in range(count):
        at_ns = BEGIN_NS + number * 4_000_000
        messages.append((topic, "std_msgs/msg/Float32", at_ns, float32(number / 4)))
        if number % 5 == 0:
            samples = TYPES["biosensor_msgs/msg/Samples"](
                header=_header(at_ns, "p01/zephyr_left"),
                sequence=number,
                lost=0,
                lost_is_estimated=False,
                labels=["ecg"],
                units=["millivolts"],
                offsets_ns=np.arange(5) * 4_000_000,
                data=(number + np.arange(5)) / 4,
                integers=np.empty(0, np.int64),
            )
            stamped = (f"{topic}_stamped", "biosensor_msgs/msg/Samples", at_ns, samples)
            messages.append(stamped)
    return messages


def test_a_bag_of_the_node_becomes_its_streams_and_the_same_topics_again(tmp_path: Path) -> None:
    topic = "/p01/biosensors/zephyr_left/ecg"
    made.write_bag(tmp_path / "live", _live(topic, 50))
    imported = import_bag(tmp_path / "live", tmp_path / "live.xdf")
    assert imported.streams == ((f"{topic}_stamped", 50),)
    missing = "the node's list of streams is not in the bag"
    assert imported.guess.startswith(f"{topic}_stamped: {missing}")
    with open_contents(tmp_path / "live.xdf") as contents:
        (stream,) = contents.streams
        assert (stream.header.format.value, stream.meaning.units) == ("float32", ("millivolts",))
        assert stream.meaning.identity.participant == "p01"
    outcome = made.to_bag(tmp_path / "live.xdf", tmp_path / "again")
    assert not outcome.written[0].notes
    again = import_bag(tmp_path / "again", tmp_path / "again.xdf")
    assert again.streams == ((f"{topic}_stamped", 50),)
    assert again.guess == ""
    (first,), (second,) = made.held(tmp_path / "live.xdf"), made.held(tmp_path / "again.xdf")
    assert first.bits == second.bits
    assert first.xml == second.xml
    np.testing.assert_allclose(first.stamps, second.stamps, rtol=0, atol=1e-6)


def test_texts_beside_numbers_are_a_stream_of_their_own(tmp_path: Path) -> None:
    pair = TYPES["diagnostic_msgs/msg/KeyValue"]
    told: Any = [pair("speed", "3"), pair("mode", "slow \N{SNOWMAN}")]
    diagnosed = TYPES["diagnostic_msgs/msg/DiagnosticStatus"](1, "motor", "hot", "U1", told)
    logged = TYPES["rcl_interfaces/msg/Log"](
        TYPES["builtin_interfaces/msg/Time"](1, 2), 20, "node", "stim_3", "a.cpp", "main", 7
    )
    joints = TYPES["sensor_msgs/msg/JointState"](
        _header(BEGIN_NS), ["elbow"], np.array([0.5]), np.empty(0), np.empty(0)
    )
    made.write_bag(
        tmp_path / "live",
        [
            ("/state", "diagnostic_msgs/msg/DiagnosticStatus", BEGIN_NS, diagnosed),
            ("/state", "diagnostic_msgs/msg/DiagnosticStatus", BEGIN_NS + 10**9, diagnosed),
            ("/joints", "sensor_msgs/msg/JointState", BEGIN_NS, joints),
            ("/log", "rcl_interfaces/msg/Log", BEGIN_NS, logged),
        ],
    )
    imported = import_bag(tmp_path / "live", tmp_path / "live.xdf")
    assert imported.left_out == {}
    with open_contents(tmp_path / "live.xdf") as contents:
        texts = {
            each.header.name: [
                json.loads(text) for block in each.blocks() for (text,) in block.values
            ]
            for each in contents.streams
            if each.header.name.endswith("__text")
        }
        events = [text for _, text in markers(choose(contents, Selection()))]
    told_once = {
        "name": "motor",
        "message": "hot",
        "hardware_id": "U1",
        "values": [{"key": "speed", "value": "3"}, {"key": "mode", "value": "slow \N{SNOWMAN}"}],
    }
    # What only names numbers is in their labels.
    assert texts == {
        "state__text": [told_once, told_once],
        "log__text": [{"name": "node", "msg": "stim_3", "file": "a.cpp", "function": "main"}],
    }
    # Each is an event in all exports.
    assert len(events) == 3


def test_the_nodes_list_of_streams_tells_what_its_topics_do_not(tmp_path: Path) -> None:
    topic = "/p01/biosensors/zephyr_left/ecg"
    pair = TYPES["diagnostic_msgs/msg/KeyValue"]
    told = {
        "lsl_name": "p01-zephyr__left-U1-ecg",
        "lsl_type": "ECG",
        "source_id": "p01@zephyr.left-ecg",
        "host": "pc",
        "rate": "250",
        "format": "float32",
        "labels": "ecg",
        "units": "millivolts",
        "participant": "p01",
        "label": "left",
        "foreign": "false",
        f"topic {topic}": "std_msgs/msg/Float32",
        f"topic {topic}_stamped": "biosensor_msgs/msg/Samples",
    }
    status = TYPES["diagnostic_msgs/msg/DiagnosticStatus"](
        0, topic, "", "U1", [pair(key, value) for key, value in told.items()]
    )
    listed = TYPES["diagnostic_msgs/msg/DiagnosticArray"](_header(BEGIN_NS), [status])
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    made.write_bag(
        tmp_path / "live", [("/lsl_to_ros/streams", kind, BEGIN_NS, listed), *_live(topic, 50)]
    )
    assert import_bag(tmp_path / "live", tmp_path / "live.xdf").guess == ""
    with open_contents(tmp_path / "live.xdf") as contents:
        (stream,) = contents.streams
    assert stream.header.refused == ""
    assert (stream.header.rate, stream.header.name) == (250.0, told["lsl_name"])
    identity = stream.meaning.identity
    assert (identity.sensor, identity.label, identity.unit) == ("zephyr", "left", "U1")


def test_what_is_imported_is_a_good_recording(tmp_path: Path) -> None:
    made.write_bag(tmp_path / "robot", _robot())
    import_bag(tmp_path / "robot", tmp_path / "robot.xdf")
    report = judge(read_recording(tmp_path / "robot.xdf"))
    assert report.is_good, [finding.text for finding in report.findings]


@pytest.mark.parametrize("mode", [CompressionMode.STORAGE, CompressionMode.MESSAGE])
def test_compressed_bags_are_read(tmp_path: Path, mode: CompressionMode) -> None:
    writer = Writer(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/load", "std_msgs/msg/Float64", typestore=STORE)
        for number in range(100):
            message = TYPES["std_msgs/msg/Float64"](float(number))
            writer.write(topic, BEGIN_NS + number, STORE.serialize_cdr(message, topic.msgtype))
    import_bag(tmp_path / "a", tmp_path / "a.xdf")
    (stream,) = made.held(tmp_path / "a.xdf")
    assert np.asarray(stream.values)[:, 0].tolist() == list(range(100))


def _counted(folder: Path, begin: int, end: int) -> Path:
    """Return the only file of a bag of numbers from `begin` to before `end`."""
    float64 = TYPES["std_msgs/msg/Float64"]
    messages = [
        ("/load", "std_msgs/msg/Float64", BEGIN_NS + number, float64(float(number)))
        for number in range(begin, end)
    ]
    made.write_bag(folder, messages)
    (file,) = folder.glob("*.mcap")
    return file


def _packed(file: Path, keeps: float = 1.0) -> bytes:
    content = zstd.compress(file.read_bytes())
    return content[: int(keeps * len(content))]


def _split(folder: Path, *parts: bytes, packed: tuple[int, ...]) -> Path:
    folder.mkdir()
    for number, part in enumerate(parts):
        suffix = ".mcap.zstd" if number in packed else ".mcap"
        (folder / f"a_{number}{suffix}").write_bytes(part)
    return folder


def test_a_bag_may_be_packed_in_part(tmp_path: Path) -> None:
    parts = [_counted(tmp_path / f"p{n}", 10 * n, 10 * n + 10) for n in range(3)]
    contents = [_packed(parts[0]), parts[1].read_bytes(), _packed(parts[2])]
    bag = _split(tmp_path / "a", *contents, packed=(0, 2))
    # A recorder died while it packed this one.
    (bag / "a_1.mcap.zstd").write_bytes(_packed(parts[1], 0.5))
    imported = import_bag(bag, tmp_path / "a.xdf")
    assert imported.damages == ()
    (stream,) = made.held(tmp_path / "a.xdf")
    assert np.asarray(stream.values)[:, 0].tolist() == list(range(30))
    import_bag(bag / "a_2.mcap.zstd", tmp_path / "file.xdf")
    (stream,) = made.held(tmp_path / "file.xdf")
    assert np.asarray(stream.values)[:, 0].tolist() == list(range(20, 30))


@pytest.mark.parametrize("content", [b"", b"nonsense", None])
def test_of_a_packed_file_that_is_damaged_it_is_said(tmp_path: Path, content: bytes | None) -> None:
    part = _counted(tmp_path / "part", 0, 10)
    packed = _packed(part, 0.5) if content is None else content
    bag = _split(tmp_path / "a", packed, part.read_bytes(), packed=(0,))
    imported = import_bag(bag, tmp_path / "a.xdf")
    assert any(each.startswith("a_0.mcap.zstd: ") for each in imported.damages)
    ((_, count),) = imported.streams
    assert count >= 10


def _bag_file(folder: Path, count: int = 60_000) -> Path:
    float64 = TYPES["std_msgs/msg/Float64"]
    messages = [("/load", "std_msgs/msg/Float64", BEGIN_NS + n, float64(n)) for n in range(count)]
    made.write_bag(folder / "long", messages)
    (file,) = (folder / "long").glob("*.mcap")
    return file


def test_of_a_bag_that_was_cut_off_what_is_whole_is_read(tmp_path: Path) -> None:
    file = _bag_file(tmp_path)
    content = file.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 3 * 2])
    imported = import_bag(tmp_path / "cut.mcap", tmp_path / "cut.xdf")
    (damage,) = imported.damages
    assert "cut off" in damage
    ((_, count),) = imported.streams
    assert 1000 < count < 60_000
    (stream,) = made.held(tmp_path / "cut.xdf")
    assert np.asarray(stream.values)[:, 0].tolist() == list(range(count))


def test_a_flipped_byte_costs_what_it_hit(tmp_path: Path) -> None:
    file = _bag_file(tmp_path)
    content = bytearray(file.read_bytes())
    # A length inside the first chunk.
    content[2000] ^= 0xFF
    file.write_bytes(content)
    imported = import_bag(tmp_path / "long", tmp_path / "a.xdf")
    ((_, count),) = imported.streams
    assert count >= 3000
    assert len(imported.damages) <= 2


def test_messages_that_are_none_are_counted(tmp_path: Path) -> None:
    with Writer(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/load", "std_msgs/msg/Float64", typestore=STORE)
        good = STORE.serialize_cdr(TYPES["std_msgs/msg/Float64"](1.5), topic.msgtype)
        for content in (good, b"\x00\x01\x00\x00\x01", good, b""):
            writer.write(topic, BEGIN_NS, content)
    imported = import_bag(tmp_path / "a", tmp_path / "a.xdf")
    assert imported.streams == (("/load", 2),)
    assert imported.damages == (
        "/load: 2 messages are left out (it is not a std_msgs/msg/Float64)",
    )


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.mcap", b"nonsense", BagReason.NOT_A_BAG),
        ("b.mcap", b"", BagReason.NOT_A_BAG),
        ("a.db3", b"nonsense" * 100, BagReason.NOT_A_BAG),
        ("a.bag", b"#ROSBAG V2.0", BagReason.NOT_A_BAG),
        ("a.mcap", b"\x89MCAP0\r\n", BagReason.EMPTY),
    ],
)
def test_what_is_no_bag_is_refused(
    tmp_path: Path, name: str, content: bytes, reason: BagReason
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError) as caught:
        import_bag(tmp_path / name, tmp_path / "a.xdf")
    assert caught.value.reason is reason
    assert str(tmp_path / name) in str(caught.value)
    assert not (tmp_path / "a.xdf").exists()


def test_the_command_says_what_it_did(tmp_path: Path) -> None:
    made.write_bag(tmp_path / "robot", _robot())
    result = CliRunner().invoke(app, ["import", str(tmp_path / "robot"), "--json"])
    assert result.exit_code == 0
    told = json.loads(result.output)
    assert told["written"] == str(tmp_path / "robot.xdf")
    assert sum(each["samples"] for each in told["streams"]) == 401
    again = CliRunner().invoke(app, ["import", str(tmp_path / "robot")])
    assert "exists and is not overwritten" in str(again.exception)


def test_a_clock_that_nobody_knows_is_said(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg")
    samples = made.xdf_file.samples(1, "float32", [[0.5], [1.5]], [math.inf, 9.0])
    (tmp_path / "a.xdf").write_bytes(made.xdf_file.xdf(header, samples))
    outcome = made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    (note,) = outcome.written[0].notes
    assert "start in 1970" in note
    import_bag(tmp_path / "a", tmp_path / "b.xdf")
    (stream,) = made.held(tmp_path / "b.xdf")
    assert stream.stamps.tolist() == [9.0]


def test_samples_without_a_time_of_day_are_left_out_and_counted(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg")
    values, stamps = [[0.5], [1.5], [2.5], [3.5]], [-1e300, 9.0, 9.004, 1e300]
    samples = [
        made.xdf_file.samples(1, "float32", [value], [stamp])
        for value, stamp in zip(values, stamps, strict=True)
    ]
    (tmp_path / "a.xdf").write_bytes(made.xdf_file.xdf(header, *samples))
    outcome = made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    _, left_out = outcome.written[0].notes
    assert left_out == "2 samples of zephyr-U1-ecg are not in it: their timestamp is not valid"
    import_bag(tmp_path / "a", tmp_path / "b.xdf")
    (stream,) = made.held(tmp_path / "b.xdf")
    assert stream.stamps.tolist() == [9.0, 9.004]


def test_without_any_time_there_is_no_bag(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg")
    samples = made.xdf_file.samples(1, "float32", [[0.5]], [1e300])
    (tmp_path / "a.xdf").write_bytes(made.xdf_file.xdf(header, samples))
    with pytest.raises(RecordingError) as caught:
        made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    assert caught.value.reason is RecordingReason.EMPTY
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("raw_type", "labels", "expected"),
    [
        ("std_msgs/msg/UInt8", "HR", "std_msgs/msg/UInt8"),
        # As for clients of the original framework.
        ("std_msgs/msg/Int32", "HR", "std_msgs/msg/Float32"),
        ("other_msgs/msg/Some", "X, Y", "std_msgs/msg/Float32MultiArray"),
    ],
)
def test_a_stream_is_known_by_the_list_also_where_its_raw_topic_has_another_type(
    raw_type: str, labels: str, expected: str
) -> None:
    topic = "/biosensors/polar_h10/hr"
    values = {
        "lsl_name": "polar_h10-U1-hr",
        "lsl_type": "HR",
        "source_id": "polar_h10-U1-hr",
        "host": "lab-pc",
        "rate": "0",
        "format": "float32",
        "foreign": "false",
        "labels": labels,
        "units": labels,
        "participant": "",
        "label": "",
        f"topic {topic}": raw_type,
        f"topic {topic}_stamped": "biosensor_msgs/msg/Samples",
    }
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    entry = SimpleNamespace(name=topic, hardware_id="U1", values=pairs)
    facts = listed_facts([entry])[f"{topic}_stamped"]
    assert (facts.name, facts.host) == ("polar_h10-U1-hr", "lab-pc")
    assert dict(facts.block)["message_type"] == expected


# Messages of our types that are not what they are elsewhere: said in a sentence, and left out.
HEADER, TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
GOOD = mcap_bytes.topic(
    9, "/load", "std_msgs/msg/Float64", made.typestore().types["std_msgs/msg/Float64"](1.5)
)
FIELDS = [
    (kind, owner, field)
    for kind, owners in ((SAMPLES, (SAMPLES, HEADER, TIME)), (EVENT, (EVENT,)))
    for owner in owners
    for field, _ in STORE.fielddefs[owner][1]
]


def _stamp() -> Any:
    return TYPES[HEADER](TYPES[TIME](1_790_000_000, 0), "zephyr")


def _samples(labels: list[str], units: list[str], values: int = 2) -> Any:
    empty = np.empty(0, np.int64)
    offsets = np.arange(2)
    return TYPES[SAMPLES](
        _stamp(), 0, 0, False, labels, units, offsets, np.arange(float(values)), empty
    )


def _event(text: str = "begin") -> Any:
    return TYPES[EVENT](_stamp(), 0, text)


def _import(folder: Path, *records: bytes) -> Imported:
    (folder / "a.mcap").write_bytes(mcap_bytes.file(*records, GOOD))
    return import_bag(folder / "a.mcap", folder / "a.xdf")


@pytest.mark.parametrize(("kind", "owner", "field"), FIELDS)
def test_a_definition_without_a_field_of_ours_is_said(
    tmp_path: Path, kind: str, owner: str, field: str
) -> None:
    content = STORE.serialize_cdr(_samples(["ecg"], ["mV"]) if kind == SAMPLES else _event(), kind)
    definition, _ = STORE.generate_msgdef(kind, ros_version=2)
    main, *others = definition.split("=" * 80 + "\n")
    parts = {kind: main} | {_type_of(part): part for part in others}
    parts[owner] = parts[owner].replace(f" {field}\n", " other\n")
    text = ("=" * 80 + "\n").join(parts.values())
    imported = _import(
        tmp_path,
        mcap_bytes.schema(1, kind, text),
        mcap_bytes.channel(1, 1, "/biosensors/zephyr/ecg_stamped", {}),
        mcap_bytes.message(1, mcap_bytes.BEGIN_NS, bytes(content)),
    )
    (why,) = imported.left_out.values()
    if owner == TIME:
        assert why == f"the definition of {kind} cannot be read"
    else:
        assert why == f"the bag defines {owner} without the field {field}, or with another type"
    assert imported.streams == (("/load", 1),)


def _type_of(part: str) -> str:
    package, _, name = part.partition("\n")[0].removeprefix("MSG: ").partition("/")
    return f"{package}/msg/{name}"


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (_samples([], [], 0), "0 labels and 0 units do not describe the channels of a stream"),
        (
            _samples(["ecg"], ["mV", "s"]),
            "1 labels and 2 units do not describe the channels of a stream",
        ),
        (_samples(["a", "b"], ["", ""]), "its number of values differs from its stream's"),
    ],
)
def test_samples_that_are_of_no_stream_are_left_out(tmp_path: Path, message: Any, why: str) -> None:
    topic = "/biosensors/zephyr/ecg_stamped"
    imported = _import(tmp_path, mcap_bytes.topic(1, topic, SAMPLES, message))
    assert imported.damages == (f"{topic}: 1 messages are left out ({why})",)


@pytest.mark.parametrize("form", ["float32", "string"])
def test_text_for_numbers_is_left_out(tmp_path: Path, form: str) -> None:
    header = made.xdf_file.stream_header(1, "x", fmt=form)
    xml = header[header.index(b"<info") :].decode()
    told = stream_text(RecordedStream(1, "/x_stamped", (), xml, ()))
    kind, message = (EVENT, _event()) if form != "string" else (SAMPLES, _samples(["a"], [""]))
    imported = _import(
        tmp_path,
        mcap_bytes.topic(1, TOPIC, "std_msgs/msg/String", TYPES["std_msgs/msg/String"](told)),
        mcap_bytes.topic(2, "/x_stamped", kind, message),
    )
    (damage,) = imported.damages
    assert "it has text for numbers, or numbers for text" in damage


def test_a_bag_of_nothing_else_is_refused(tmp_path: Path) -> None:
    records = mcap_bytes.topic(1, "/x_stamped", SAMPLES, _samples([], [], 0))
    (tmp_path / "a.mcap").write_bytes(mcap_bytes.file(records))
    with pytest.raises(BagError) as caught:
        import_bag(tmp_path / "a.mcap", tmp_path / "a.xdf")
    assert caught.value.reason is BagReason.EMPTY
