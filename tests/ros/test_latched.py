"""Values that change seldom are there for whoever subscribes later."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.quantities import ContentType
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.table import channels, hardware
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(autouse=True)
def attached_first(monkeypatch: pytest.MonkeyPatch, node: RunningNode) -> None:
    """The node is there before anything is pushed, so that no sample has to wait for it."""
    assert node.is_running
    monkeypatch.setattr(outlets, "ATTACH_TIME_S", 0.0)


def push(ros: Ros, sensor_name: str, data_name: str, *samples: list[float]) -> tuple[Outlet, str]:
    """Let the node receive samples that nobody reads; return the outlet and its topic."""
    return push_on(ros, declaration(sensor_name).stream(data_name), sensor_name, *samples)


def push_on(
    ros: Ros, stream: StreamSpec, sensor_name: str, *samples: list[float]
) -> tuple[Outlet, str]:
    """The same on any stream."""
    data_name = stream.data_name
    identity = DeviceIdentity(sensor_name, "BH1", participant=f"latched_{data_name}")
    outlet = Outlet(stream, identity, DeviceInfo())
    topic = f"/latched_{data_name}/biosensors/{sensor_name}/{data_name}"
    ros.attached(topic)
    now = pylsl.local_clock()
    stamps = [now - 0.01 * (len(samples) - number) for number in range(len(samples))]
    assert outlet.push(list(samples), stamps) is None

    def has_all() -> bool:
        status = ros.status(topic)
        return status is not None and status["received"] == str(len(samples))

    ros.until(has_all, "every sample in the node")
    return outlet, topic


@pytest.mark.seam
@pytest.mark.parametrize(
    ("sensor_name", "data_name", "kind", "last"),
    [
        ("zephyr", "bat", Float32, [55.0]),
        ("zephyr", "rssi", Float32, [-61.0]),
        (
            "emotiv_insight",
            "dev",
            Float32MultiArray,
            [1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 4.0, 90.0, 80.0],
        ),
    ],
)
def test_a_late_subscriber_gets_the_last_value(
    ros: Ros, sensor_name: str, data_name: str, kind: type[Any], last: list[float]
) -> None:
    _outlet, topic = push(ros, sensor_name, data_name, [9.0] * len(last), last)
    late = ros.listen(kind, topic, LATCHED)
    ros.until(lambda: bool(late), "the last value")
    ros.attached(topic, readers=1)
    ros.report()
    data = [list(message.data) if len(last) > 1 else [message.data] for message in late]
    assert data == [last]


def test_a_late_subscriber_gets_the_last_state_of_the_battery(ros: Ros) -> None:
    _outlet, topic = push(ros, "polar_h10", "bat", [99.0], [55.0])
    late = ros.listen(BatteryState, f"{topic}_state", LATCHED)
    ros.until(lambda: bool(late), "the last state")
    ros.attached(topic, readers=1)
    ros.report()
    assert [message.percentage for message in late] == [pytest.approx(0.55)]
    assert math.isnan(late[0].voltage)


def test_a_state_of_a_sensor_that_nobody_has_heard_of_is_kept(ros: Ros) -> None:
    mode = hardware("mode", ContentType.STATUS, channels("mmHg", "limit"), is_state=True)
    _outlet, topic = push_on(ros, mode, "never_heard_of", [99.0], [55.0])
    late = ros.listen(Float32, topic, LATCHED)
    ros.until(lambda: bool(late), "the last value")
    assert [message.data for message in late] == [55.0]


def test_what_changes_often_is_not_kept(ros: Ros) -> None:
    outlet, topic = push(ros, "zephyr", "posture", [99.0], [55.0])
    late = ros.listen(Float32, topic)
    ros.attached(topic, readers=1)
    assert outlet.push([12.0], [pylsl.local_clock()]) is None
    ros.until(lambda: bool(late), "what came after the subscription")
    assert [message.data for message in late] == [12.0]


def test_a_late_subscriber_gets_the_list_of_streams(ros: Ros) -> None:
    _outlet, topic = push(ros, "empatica_e4", "bat", [55.0])
    late = ros.listen(DiagnosticArray, "/lsl_to_ros/streams", LATCHED)

    def is_listed() -> bool:
        return any(status.name == topic for message in late for status in message.status)

    ros.until(is_listed, "the list, with this stream")
