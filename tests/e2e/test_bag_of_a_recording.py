"""What LabRecorder records, the topics of the session and a bag fall onto one axis."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import pyxdf
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import BatteryState, Imu
from std_msgs.msg import Float32, Float32MultiArray, String, UInt8

from biosensor_common.naming import AGENT
from biosensor_common.quantities import ChannelFormat
from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.contents.wall_clock import find_wall_clock
from tests.bags import made
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.polling import wait_until
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# What LabRecorder recorded, converted to a bag, is what the node published meanwhile.

RECORD_S = 8.0
# The recorder's measurements of clocks between two programs on one computer, and the agent's
# of the time of day.
WITHIN_NS = 1_000_000
BASE = "/p01/biosensors/zephyr"
RATES_HZ = {f"{BASE}/ecg": 250, f"{BASE}/acc": 50}
# Those of the strap and of the agent, and the node's. LabRecorder looks for a second only.
STREAMS = len([*declaration("zephyr").streams, *declaration(AGENT).streams]) + 1
TOPICS: dict[str, type[Any]] = {
    f"{BASE}/ecg": Float32,
    f"{BASE}/acc": Float32MultiArray,
    f"{BASE}/hr": UInt8,
    f"{BASE}/bat_state": BatteryState,
    "/biosensors/gateway/events": String,
}


def _value(message: Any) -> Any:
    if hasattr(message, "percentage"):
        return message.percentage, message.serial_number, message.location
    data = message.data
    return tuple(data) if hasattr(data, "__len__") and not isinstance(data, str) else data


def _place(part: list[Any], whole: list[Any]) -> int:
    """Return where a list is found in another, without anything missing or between."""
    for start in range(len(whole) - len(part) + 1):
        if whole[start : start + len(part)] == part:
            return start
    raise AssertionError(f"{part[:3]}... are not {whole[:3]}...")


def _stamps_ns(messages: list[Any]) -> NDArray[np.int64]:
    stamps = [message.header.stamp for message in messages]
    return np.array([stamp.sec * NS_PER_S + stamp.nanosec for stamp in stamps])


def test_the_bag_of_a_recording_is_what_was_published(
    programs: Any, listener: Any, tmp_path: Path
) -> None:
    live = {topic: listener.listen(kind, topic) for topic, kind in TOPICS.items()}
    with SteeredBioHarness() as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM4"\nport = "{device.port}"\n'
            'participant = "p01"\n[events]\nheartbeat_s = 1\n'
        )
        programs.node()
        wait_until(lambda: all(live.values()), "messages on all topics")
        with LabRecorder(tmp_path / "study.xdf", at_least=STREAMS):
            begun = {topic: len(live[topic]) for topic in RATES_HZ}

            def has_all(topic: str) -> bool:
                return len(live[topic]) - begun[topic] >= RECORD_S * RATES_HZ[topic]

            wait_until(lambda: all(map(has_all, RATES_HZ)), "so many seconds of samples")
        # What was recorded last is to be published, too.
        end = time.time() + 1.0
        wait_until(lambda: time.time() > end, "the last messages")
    made.to_bag(tmp_path / "study.xdf", tmp_path / "study")

    bag: dict[str, list[Any]] = {}
    with AnyReader([tmp_path / "study"]) as reader:
        kinds = {each.topic: each.msgtype for each in reader.connections}
        for connection, _, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            bag.setdefault(connection.topic, []).append(message)
    assert {kinds[topic] for topic in (f"{BASE}/ecg", f"{BASE}/hr")} == {
        "std_msgs/msg/Float32",
        "std_msgs/msg/UInt8",
    }
    for topic, rate_hz in RATES_HZ.items():
        # LabRecorder does not write what comes in its last half second.
        assert len(bag[topic]) > 0.8 * RECORD_S * rate_hz
    for topic, messages in live.items():
        published = [_value(message) for message in messages]
        converted = [_value(message) for message in bag.get(topic, [])]
        _place(converted, published)
    # Its values hardly change, so what belongs together is told by the times themselves.
    converted_ns = _stamps_ns(bag[f"{BASE}/bat_state"])
    distances = np.abs(converted_ns[:, np.newaxis] - _stamps_ns(live[f"{BASE}/bat_state"]))
    assert distances.min(axis=1).max() < WITHIN_NS
    assert (np.diff(distances.argmin(axis=1)) == 1).all()


# The real LabRecorder (its own liblsl 1.17) records the outlets as they are.
LABRECORDER_RECORD_S = 12.0
# A BioHarness 3 has no skin sensor, so this stream is there and stays empty.
EMPTY = {"st"}
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def _data_name(stream: dict[str, Any]) -> str:
    return stream["info"]["desc"][0]["biosensor"][0]["data_name"][0]


def _record(path: Path, count: int) -> dict[str, dict[str, Any]]:
    with LabRecorder(path, at_least=count):
        time.sleep(LABRECORDER_RECORD_S)
    streams, _ = _load_xdf(str(path))
    return {_data_name(stream): stream for stream in streams}


@pytest.mark.seam
def test_labrecorder_records_what_the_agent_declares(
    programs: Any,
    tmp_path: Path,
) -> None:
    declared = {stream.data_name: stream for stream in declaration("zephyr").streams}
    names = {*declared, "counters", "events", "markers"}
    source = SyntheticSource(seed=3, hrv_after_s=0)
    with SteeredBioHarness(source) as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM2"\nport = "{device.port}"\n'
            'participant = "p01"\n'
        )
        wait_until(lambda: len(device.sent) > 10, "a streaming device")
        recorded = _record(tmp_path / "study.xdf", len(names))
        status = programs.status()

    assert recorded.keys() == names
    for name, spec in declared.items():
        info = recorded[name]["info"]
        channels = info["desc"][0]["channels"][0]["channel"]
        assert [channel["label"][0] for channel in channels] == list(spec.labels)
        assert [channel["unit"][0] for channel in channels] == [c.unit for c in spec.channels]
        assert info["type"] == [spec.content_type]
        assert info["channel_format"] == [spec.format]
        assert ChannelFormat(info["channel_format"][0]) is not ChannelFormat.INT64
        assert info["source_id"] == [f"p01@zephyr-{name}"]
        assert float(info["nominal_srate"][0]) == pytest.approx(spec.rate)
        acquisition = info["desc"][0]["acquisition"][0]
        assert acquisition["model"] == ["BioHarness 3"]

    for name, stream in recorded.items():
        # pyxdf undoes clock offsets by these; two are the least that give a slope.
        assert len(stream["clock_times"]) >= 2, name
        stamps = np.asarray(stream["time_stamps"])
        assert (np.diff(stamps) >= 0).all(), name
        assert (len(stamps) == 0) == (name in EMPTY), name

    ecg = recorded["ecg"]
    assert float(ecg["info"]["effective_srate"]) == pytest.approx(250, rel=0.005)
    assert not any(counters["refused"] for counters in status["devices"][0]["streams"].values())


# A recording and the topics of one session fall onto one axis, to a millisecond.
# Longer than a heartbeat of the node, and the recorder's clock offsets come every 5 s.
AXIS_RECORD_S = 11.0
SAME_NS = 1_000_000
# Those of the headset and of the agent, and the node's. LabRecorder looks for a second only.
AXIS_STREAMS = len([*declaration("emotiv_insight").streams, *declaration(AGENT).streams]) + 1


@pytest.mark.seam
def test_wall_time_of_the_recording_is_the_stamp_of_the_topic(
    programs: Any, listener: Any, tmp_path: Path
) -> None:
    path = tmp_path / "study.xdf"
    programs.node()
    programs.start("biosensor_gateway.cli", "run", "--simulate", "emotiv_insight")

    def topics() -> list[str]:
        names = dict(listener.node.get_topic_names_and_types())
        return [name for name in names if name.endswith("/mot_imu")]

    wait_until(topics, "a topic of the motion sensor")
    messages = listener.listen(Imu, *topics())
    wait_until(lambda: len(messages) > 10, "accelerations")
    with LabRecorder(path, at_least=AXIS_STREAMS):
        time.sleep(AXIS_RECORD_S)
    published = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])
    with open_contents(path) as contents:
        wall = contents.wall
        assert wall is not None
        assert wall.source.startswith("lsl_to_ros-")
        others = [each for each in contents.streams if each.header.name != wall.source]
        by_agent = find_wall_clock(others, "", contents.begin_s)
        (motion,) = [each for each in others if each.header.data_name == "mot"]
        times = np.concatenate([each.times for each in motion.blocks()])
    recorded = wall.to_unix_ns(times)
    assert len(recorded) > 100
    after = np.clip(np.searchsorted(published, recorded), 1, len(published) - 1)
    nearest = np.minimum(
        np.abs(published[after] - recorded), np.abs(published[after - 1] - recorded)
    )
    # The last of them may not have been published when the listener was asked.
    assert nearest[: -len(recorded) // 10].max() < SAME_NS
    # Where no node runs the agent's own pairs tell the same.
    assert by_agent is not None
    assert by_agent.source.startswith(f"{AGENT}-")
    assert np.abs(by_agent.to_unix_ns(times) - recorded).max() < SAME_NS
