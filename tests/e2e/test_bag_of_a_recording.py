"""What LabRecorder recorded, converted to a bag, is what the node published meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float32, Float32MultiArray, String, UInt8

from biosensor_common.naming import AGENT
from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.devices.registry import declaration
from tests.bags import made
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

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
    programs: Any, listener: Any, wait_until: Callable[..., None], tmp_path: Path
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
