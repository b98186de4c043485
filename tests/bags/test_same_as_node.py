"""What the exporter writes is what the node publishes: same topics, types and bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
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
from biosensor_common.quantities import ChannelFormat
from biosensor_common.ros.fields import bulk_of, fields_of, has_header
from biosensor_common.ros_clock import NS_PER_S
from biosensor_common.stream_header import StreamHeader
from biosensor_common.topic_shape import queue_depth
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.recording.bag import types
from biosensor_gateway.recording.bag.messages import Topic
from biosensor_gateway.recording.export.mcap.numbers import RawNumbers
from biosensor_gateway.recording.export.mcap.standard_messages import standard_messages
from biosensor_gateway.recording.export.mcap.texts import counters_message
from lsl_to_ros.lsl.blocks import Run
from lsl_to_ros.ros_to_lsl import fields
from lsl_to_ros.topics import messages
from lsl_to_ros.topics.cdr import SampleEncoder
from lsl_to_ros.topics.standard_messages import STANDARD_MESSAGES
from tests.bags import made
from tests.rigs.recorded_topics import RecordedPublisher, header_of
from tests.xdf import xdf_file

STREAMS = [
    (name, stream.data_name) for name in declaration_names() for stream in declaration(name).streams
]
DTYPES = {ChannelFormat.FLOAT32: np.float32, ChannelFormat.INT16: "i2", ChannelFormat.INT32: "i4"}
STAMP_NS = 1_790_000_000_123_456_789


class _Clock:
    """The node's, which shows a time that was chosen."""

    def to_time(self, stamp: float) -> Any:
        return messages.Time(sec=STAMP_NS // NS_PER_S, nanosec=STAMP_NS % NS_PER_S)


def _values(header: StreamHeader) -> NDArray[Any]:
    rng = np.random.default_rng(len(header.labels))
    values = rng.integers(0, 200, (6, len(header.labels))).astype(np.float64) / 8
    if header.format.is_float:
        values[2] = np.nan
        values[3, 0] = np.nan
        values[4, -1] = np.inf
    return values.astype(DTYPES[header.format])


@pytest.mark.parametrize(("sensor", "data"), STREAMS)
def test_raw_messages_have_the_nodes_bytes(sensor: str, data: str) -> None:
    header = header_of(sensor, data)
    if header.message_type.is_text:
        return
    values = _values(header)
    ours = RawNumbers(header.message_type, len(header.labels))
    theirs = SampleEncoder(header.message_type, len(header.labels))
    kind = messages.CLASSES[header.message_type]
    for own, node in zip(ours.encode(values), theirs.encode(values), strict=True):
        assert str(deserialize_message(own, kind)) == str(deserialize_message(node, kind))


@pytest.mark.parametrize(("sensor", "data"), STREAMS)
def test_standard_messages_have_the_nodes_bytes(sensor: str, data: str) -> None:
    header = header_of(sensor, data, "p01", "left")
    node = {each.topic_of(header): each for each in STANDARD_MESSAGES if each.topic_of(header)}
    ours = {each.data: each for each in standard_messages(header, "p01/x_left")}
    assert list(ours) == list(node)
    for name, writer in node.items():
        publisher = RecordedPublisher(writer.message_class)
        values = _values(header)
        run = Run(values, np.zeros(len(values)), 0)
        writer(publisher, header, "p01/x_left", _Clock()).write(run)  # type: ignore[arg-type]
        made_here = ours[name].encode(np.full(len(values), STAMP_NS), values)
        kind = writer.message_class
        assert ours[name].type_name == publisher.type_name
        for own, published in zip(made_here, publisher.messages, strict=True):
            # By their text: NaN is no equal of itself.
            assert str(deserialize_message(own, kind)) == str(published)


def test_counters_have_the_nodes_bytes() -> None:
    text = (
        '{"zephyr-U1-ecg":{"pushed":12,"lost":0,"last_stamp":10.25,"clock":{"offset_s":1.5,'
        '"drift_ppm":-2.0,"residual_rms_s":0.001,"reanchors":0}},'
        '"a":{"pushed":1,"lost":2,"last_stamp":0.0}}'
    )
    kind = messages.DiagnosticArray
    node = messages.counters_message(text, _Clock().to_time(0.0))
    assert deserialize_message(counters_message(STAMP_NS, text), kind) == node


def test_types_have_the_nodes_fields() -> None:
    compared = 0
    for name in types.typestore().fielddefs:
        try:
            live = fields.message_class(name)
        except GatewayError:
            continue
        compared += 1
        definition = types.MessageType(Topic("/a", name)).definition
        assert fields_of(definition) == fields.fields_of(live), name
        assert has_header(definition) == fields.has_header(live), name
        assert bulk_of(definition) == fields.bulk_of(live), name
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
