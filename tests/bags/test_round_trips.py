"""Recordings as bags: the same as live, the same as the node's, the same when they return."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    Qos,
    QosDurability,
    QosHistory,
    QosReliability,
)
from rosbags.rosbag2 import Reader

from biosensor_common.errors import GatewayError
from biosensor_common.naming import source_id
from biosensor_common.quantities import queue_depth
from biosensor_common.ros.fields import bulk_of, fields_of, has_header
from biosensor_common.ros_clock import NS_PER_S
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.bag import types
from biosensor_gateway.recording.bag.conversion import import_bag
from biosensor_gateway.recording.bag.types import Topic
from biosensor_gateway.recording.contents.contents import open_contents
from lsl_to_ros.ros_to_lsl import class_fields
from tests.bags import made
from tests.system import bag_reader
from tests.xdf import xdf_file
from tests.xdf.checking import load_by_pyxdf

# A recording that becomes a bag, and that a recording again, is the same.

MICROSECOND = 1e-6
DAY_NS = 1_790_000_000_000_000_000
FORMATS = ("float32", "double64", "int8", "int16", "int32", "int64", "string")
INTEGERS = {"int8": 7, "int16": 15, "int32": 31, "int64": 63}
ANY_TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)


def _there_and_back(content: bytes, folder: Path) -> tuple[list[made.Held], list[made.Held]]:
    recording, bag, back = folder / "a.xdf", folder / "a", folder / "b.xdf"
    recording.write_bytes(content)
    made.to_bag(recording, bag)
    imported = import_bag(bag, back)
    assert not imported.damages and not imported.left_out
    return made.held(recording), made.held(back)


def _assert_same(before: list[made.Held], after: list[made.Held]) -> None:
    assert [each.xml for each in after] == [each.xml for each in before]
    for old, new in zip(before, after, strict=True):
        assert new.bits == old.bits
        np.testing.assert_allclose(new.stamps, old.stamps, rtol=0, atol=MICROSECOND)
        if old.offsets:
            assert new.offsets == old.offsets


def _in_chunks(
    number: int, form: str, values: list[list[Any]], stamps: list[float], length: int
) -> list[bytes]:
    parts = [slice(at, at + length) for at in range(0, len(stamps), length)]
    return [xdf_file.samples(number, form, values[part], list(stamps[part])) for part in parts]


def _beats(pairs: dict[float, int]) -> bytes:
    """The agent's heartbeats, which tell the time of day."""
    texts = [
        [json.dumps({"event": "heartbeat", "clock": {"lsl_s": at, "unix_ns": unix_ns}})]
        for at, unix_ns in pairs.items()
    ]
    desc = made.described(["event"], [""])
    block = made.ET.SubElement(desc, "biosensor")
    for name, text in {
        "version": "1",
        "sensor": "gateway",
        "unit": "pc",
        "participant": "",
        "label": "",
        "data_name": "events",
        "category": "event",
        "message_type": "std_msgs/msg/String",
        "chunk": "",
    }.items():
        made.ET.SubElement(block, name).text = text
    identity = DeviceIdentity("gateway", "pc")
    header = xdf_file.stream_header(
        90, "gateway-pc-events", fmt="string", source_id=source_id(identity, "events"), desc=desc
    )
    return header + xdf_file.samples(90, "string", texts, list(pairs))


def test_every_format_and_another_computers_clock(tmp_path: Path) -> None:
    stamps = [100.0 + n / 7 for n in range(60)]
    pairs = {100.0 + 2 * n: DAY_NS + n * 2_000_040_000 for n in range(6)}
    parts = [_beats(pairs)]
    for number, form in enumerate(FORMATS, 1):
        if form == "string":
            values: list[list[Any]] = [[f"\u00e4 {n}", "\U0001f9e0"] for n in range(60)]
        else:
            values = [[n - 30 + (form == "int64") * 2**60, n % 7] for n in range(60)]
        parts.append(xdf_file.stream_header(number, f"s{number}", channels=2, fmt=form))
        # LSL's clock is that of another computer, which drifts.
        parts += [
            xdf_file.clock_offset(number, at, 5e4 + at * 2e-5) for at in (100.0, 103.0, 106.0)
        ]
        parts += _in_chunks(number, form, values, stamps, 9)
    before, after = _there_and_back(made.dated(*parts), tmp_path)
    _assert_same(before, after)
    assert len(before[1].stamps) == 60
    assert before[1].offsets[1] == (103.0, 5e4 + 103.0 * 2e-5)


def test_the_clock_of_a_computer_that_was_started_again(tmp_path: Path) -> None:
    """Markers before and behind it are seconds apart, and near no clock offset."""
    parts = [
        xdf_file.stream_header(1, "markers", fmt="string"),
        xdf_file.offsets(1, (653_000.0, 653_005.0), -652_000.0),
        xdf_file.samples(1, "string", [["a"], ["b"]], [653_001.0, 653_006.0]),
        xdf_file.offsets(1, (8.0, 13.0), 1005.0),
        xdf_file.samples(1, "string", [["c"], ["d"]], [7.5, 12.0]),
    ]
    before, after = _there_and_back(made.dated(*parts), tmp_path)
    _assert_same(before, after)


def test_streams_without_samples_and_of_one_name_keep_apart(tmp_path: Path) -> None:
    parts = [
        xdf_file.stream_header(3, "twin", rate=4.0),
        xdf_file.stream_header(5, "empty"),
        xdf_file.stream_header(7, "twin", rate=4.0),
        xdf_file.stream_header(8, "twin", rate=4.0, channels=2, fmt="int16"),
        xdf_file.samples(3, "float32", [[1.0], [2.0]], [10.0, 10.25]),
        xdf_file.samples(7, "float32", [[3.0], [4.0]], [10.1, 10.35]),
        xdf_file.samples(8, "int16", [[5, 6]], [10.2]),
    ]
    before, after = _there_and_back(made.dated(*parts), tmp_path)
    _assert_same(before, after)
    assert [len(each.stamps) for each in after] == [2, 0, 2, 1]


def test_a_bag_becomes_a_recording_and_the_same_bag_again(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg", "p01", "left")
    samples = xdf_file.samples(1, "float32", [[0.5], [1.5], [float("nan")]], [9.0, 9.1, 9.2])
    (tmp_path / "a.xdf").write_bytes(made.dated(header, samples))
    made.to_bag(tmp_path / "a.xdf", tmp_path / "first")
    import_bag(tmp_path / "first", tmp_path / "b.xdf")
    made.to_bag(tmp_path / "b.xdf", tmp_path / "second")
    first, second = (_messages(tmp_path / name) for name in ("first", "second"))
    assert first.keys() == second.keys()
    for topic, messages in first.items():
        if topic != "/biosensors/recorded_streams":
            for (old_ns, old), (new_ns, new) in zip(messages, second[topic], strict=True):
                assert abs(old_ns - new_ns) <= 1000
                assert old[20:] == new[20:]


def _messages(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with AnyReader([bag]) as reader:
        for connection, unix_ns, content in reader.messages():
            found.setdefault(connection.topic, []).append((unix_ns, bytes(content)))
    return found


def test_others_load_what_was_made_of_a_bag(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg")
    stamps = [50.0 + n / 250 for n in range(5000)]
    content = [header]
    content += _in_chunks(1, "float32", [[stamp] for stamp in stamps], stamps, 100)
    _there_and_back(made.dated(*content), tmp_path)
    (stream,) = load_by_pyxdf(tmp_path / "b.xdf")
    assert stream["info"]["name"] == ["zephyr-U1-ecg"]
    assert stream["footer"]["info"]["sample_count"] == ["5000"]
    np.testing.assert_allclose(stream["time_stamps"], stamps, rtol=0, atol=MICROSECOND)
    assert np.diff(stream["clock_times"]).max() < 6.0
    assert set(stream["clock_values"]) == {0.0}


@st.composite
def _streams(draw: st.DrawFn) -> bytes:
    parts: list[bytes] = []
    for number in range(1, draw(st.integers(1, 3)) + 1):
        form, channels = draw(st.sampled_from(FORMATS[:5] + FORMATS[6:])), draw(st.integers(1, 3))
        name = draw(ANY_TEXT.filter(lambda text: text.isprintable()))
        parts.append(
            xdf_file.stream_header(
                number, name, channels=channels, fmt=form, rate=draw(st.sampled_from([0.0, 10.0]))
            )
        )
        value: st.SearchStrategy[Any] = ANY_TEXT
        if form in INTEGERS:
            value = st.integers(-(2 ** INTEGERS[form]), 2 ** INTEGERS[form] - 1)
        elif form != "string":
            value = st.floats(width=32 if form == "float32" else 64, allow_nan=True)
        rows = draw(st.lists(st.lists(value, min_size=channels, max_size=channels), max_size=12))
        stamps = sorted(draw(st.lists(st.floats(1, 1e6), min_size=len(rows), max_size=len(rows))))
        parts += _in_chunks(number, form, rows, stamps, 5)
    parts += [xdf_file.stream_header(99, "last"), xdf_file.samples(99, "float32", [[0.0]], [1e6])]
    return made.dated(*parts)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(content=_streams())
def test_any_recording_comes_back(content: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    _assert_same(*_there_and_back(content, tmp_path_factory.mktemp("trip")))


# The reader of bags that were recorded live reads a recording that was made a bag.
SAMPLES = 60


@pytest.mark.parametrize(
    ("sensor", "data"), [("zephyr", "ecg"), ("emotiv_insight", "eeg"), ("empatica_e4", "acc")]
)
def test_values_times_numbers_and_channels_are_the_recordings(
    tmp_path: Path, sensor: str, data: str
) -> None:
    header, channels = made.declared(1, sensor, data, "p01")
    values = np.arange(SAMPLES * channels, dtype=np.float32).reshape(SAMPLES, channels) / 4
    stamps = 5000 + np.arange(SAMPLES) / 64
    parts = [
        xdf_file.samples(1, "float32", values[at : at + 7].tolist(), stamps[at : at + 7].tolist())
        for at in range(0, SAMPLES, 7)
    ]
    (tmp_path / "a.xdf").write_bytes(made.dated(header, *parts))
    made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    topics = bag_reader.read(tmp_path / "a")
    read = topics[f"/p01/biosensors/{sensor}/{data}_stamped"]
    with open_contents(tmp_path / "a.xdf") as contents:
        (stream,) = contents.streams
        wall = contents.wall
        assert wall is not None
        expected_ns = wall.to_unix_ns(np.concatenate([each.times for each in stream.blocks()]))
    np.testing.assert_array_equal(read.track.values, values)
    np.testing.assert_array_equal(read.track.times_ns, expected_ns)
    assert np.ptp(read.track.times_ns) / NS_PER_S == pytest.approx(np.ptp(stamps), abs=1e-6)
    assert read.track.labels == stream.header.labels
    assert read.track.units == stream.meaning.units
    assert read.sequences.tolist() == list(range(SAMPLES))
    assert read.frame_ids == {f"p01/{sensor}"}


# What the exporter writes is what the node publishes: same topics, types and bytes.
def test_types_have_the_nodes_fields() -> None:
    compared = 0
    for name in types.typestore().fielddefs:
        try:
            live = class_fields.message_class(name)
        except GatewayError:
            continue
        compared += 1
        definition = types.MessageType(Topic("/a", name)).definition
        assert fields_of(definition) == class_fields.fields_of(live), name
        assert has_header(definition) == class_fields.has_header(live), name
        assert bulk_of(definition) == class_fields.bulk_of(live), name
    assert compared > 100


def test_our_messages_are_those_that_colcon_builds() -> None:
    built = made.typestore()
    for name in (types.SAMPLES, types.EVENT):
        assert types.typestore().hash_rihs01(name) == built.hash_rihs01(name)


def test_topics_types_and_qos_are_the_nodes(tmp_path: Path) -> None:
    parts: list[bytes] = []
    chosen = [
        ("zephyr", "ecg", "p01", "left"),
        ("zephyr", "bat", "p01", "left"),
        ("emotiv_insight", "mot", "p02", ""),
        ("empatica_e4", "tag", "", ""),
    ]
    for number, (sensor, data, participant, label) in enumerate(chosen, 1):
        header, channels = made.declared(number, sensor, data, participant, label)
        is_text = data == "tag"
        sample: list[Any] = ["pressed"] if is_text else [0.5] * channels
        form = "string" if is_text else "float32"
        parts += [header, xdf_file.samples(number, form, [sample], [9.0])]
    (tmp_path / "a.xdf").write_bytes(made.dated(*parts))
    made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    with Reader(tmp_path / "a") as bag:
        found = {each.topic: (each.msgtype, _qos(each)) for each in bag.connections}
    found.pop("/biosensors/recorded_streams")
    base = "/p01/biosensors/zephyr_left"
    assert {topic: kind for topic, (kind, _) in found.items()} == {
        f"{base}/ecg": "std_msgs/msg/Float32",
        f"{base}/ecg_stamped": "biosensor_msgs/msg/Samples",
        f"{base}/bat": "std_msgs/msg/Float32",
        f"{base}/bat_stamped": "biosensor_msgs/msg/Samples",
        f"{base}/bat_state": "sensor_msgs/msg/BatteryState",
        "/p02/biosensors/emotiv_insight/mot": "std_msgs/msg/Float32MultiArray",
        "/p02/biosensors/emotiv_insight/mot_stamped": "biosensor_msgs/msg/Samples",
        "/p02/biosensors/emotiv_insight/mot_imu": "sensor_msgs/msg/Imu",
        "/p02/biosensors/emotiv_insight/mot_mag": "sensor_msgs/msg/MagneticField",
        "/biosensors/empatica_e4/tag": "std_msgs/msg/Empty",
        "/biosensors/empatica_e4/tag_stamped": "biosensor_msgs/msg/Event",
    }
    for topic, (_, qos) in found.items():
        is_state = "/bat" in topic
        assert qos.reliability is QosReliability.RELIABLE
        assert qos.history is QosHistory.KEEP_LAST
        expected = QosDurability.TRANSIENT_LOCAL if is_state else QosDurability.VOLATILE
        assert qos.durability is expected
        assert qos.depth == 1 if is_state else qos.depth == queue_depth(_rate(topic))


def _qos(connection: Connection) -> Qos:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    (qos,) = connection.ext.offered_qos_profiles
    return qos


def _rate(topic: str) -> float:
    data = topic.rpartition("/")[2].split("_", maxsplit=1)[0]
    return {"ecg": 250.0, "mot": made.UNTOLD_RATE_HZ}.get(data, 0.0)
