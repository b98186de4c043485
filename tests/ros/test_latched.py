"""Values that change seldom are there for whoever subscribes later."""

from __future__ import annotations

from typing import Any

import pylsl
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32

from biosensor_common.registry import sensor
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway import outlets
from biosensor_gateway.outlets import Outlet

IDENTITY = DeviceIdentity("zephyr", "BH1", participant="latched")


@pytest.mark.parametrize(("data_name", "values"), [("bat", [55.0]), ("posture", [])])
def test_a_late_subscriber_gets_the_last_battery_level(
    ros: Any, node: Any, monkeypatch: pytest.MonkeyPatch, data_name: str, values: list[float]
) -> None:
    # The node is attached before anything is pushed.
    monkeypatch.setattr(outlets, "ATTACH_TIME_S", 0.0)
    outlet = Outlet(sensor("zephyr").stream(data_name), IDENTITY, DeviceInfo())
    topic = f"/latched/biosensors/zephyr/{data_name}"
    ros.attached(topic)
    assert outlet.push([99.0, 55.0], [pylsl.local_clock() - 0.01, pylsl.local_clock()]) is None
    ros.until(lambda: ros.status(topic)["received"] == "2", "two samples in the node")
    late: list[Float32] = []
    durability = DurabilityPolicy.TRANSIENT_LOCAL if values else DurabilityPolicy.VOLATILE
    qos = QoSProfile(depth=1, durability=durability)
    subscription = ros.node.create_subscription(Float32, topic, late.append, qos)
    ros.attached(topic, readers=1)
    ros.report()
    ros.node.destroy_subscription(subscription)
    assert [message.data for message in late] == values
    assert node.is_running
