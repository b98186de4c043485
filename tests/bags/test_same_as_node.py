"""What the exporter writes is what the node publishes: same topics, types and bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
from biosensor_common.ros.fields import bulk_of, fields_of, has_header
from biosensor_common.topic_shape import queue_depth
from biosensor_gateway.recording.bag import types
from biosensor_gateway.recording.bag.messages import Topic
from lsl_to_ros.ros_to_lsl import fields
from tests.bags import made
from tests.xdf import xdf_file


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
