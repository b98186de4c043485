"""Clients of the original framework at the real node."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32MultiArray, Int32

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

Start = Callable[..., "RunningNode"]
STRAP, HEADSET = "polar_h10", "emotiv_insight"


def declared(sensor: str, data: str) -> Outlet:
    return Outlet(declaration(sensor).stream(data), DeviceIdentity(sensor, "U1"), DeviceInfo())


def test_clients_get_the_types_and_columns_that_they_know(ros: Ros, start_node: Start) -> None:
    node = start_node("--ros-args", "-p", "compat:=smartlab")
    rate, interval = declared(STRAP, "hr"), declared(STRAP, "ibi")
    eeg, status = declared(HEADSET, "eeg"), declared(HEADSET, "eeg_status")
    base, head = f"/biosensors/{STRAP}", f"/biosensors/{HEADSET}"
    whole = {data: ros.listen(Int32, f"{base}/{data}") for data in ("hr", "ibi", "dev")}
    rows = ros.listen(Float32MultiArray, f"{head}/eeg")
    ros.attached(f"{base}/hr", f"{head}/eeg", readers=1)
    ros.attached(f"{base}/ibi", readers=2)
    now = pylsl.local_clock()
    assert rate.push([[61.0]], [now]) is None
    assert interval.push([[853 / 1024]], [now]) is None
    for number in range(20):
        stamp = [now + number / 128]
        assert eeg.push([[number + 0.5] * 5], stamp) is None
        assert status.push([[float(number), 0.0, 1000.0, 0.0]], stamp) is None
    ros.until(lambda: all(whole.values()) and len(rows) == 20, "what a client of the original gets")
    assert {data: heard[0].data for data, heard in whole.items()} == {
        "hr": 61,
        "ibi": 853 % 256,
        "dev": 853 // 256,
    }
    assert [list(row.data) for row in rows] == [
        [number, 0.0, *[number + 0.5] * 5, 1000.0] for number in range(20)
    ]
    found = ros.status("node")
    assert found is not None
    assert found["compat"] == "smartlab"
    assert node.count("WARN", "without") == 0


def test_without_it_a_client_is_told_what_to_do(ros: Ros, start_node: Start) -> None:
    start_node()
    rate = declared(STRAP, "hr")
    topic = f"/biosensors/{STRAP}/hr"
    ros.until(lambda: ros.status(topic) is not None, "its entry")
    ros.listen(Int32, topic)

    def is_told() -> bool:
        found = ros.status(topic)
        return (
            found is not None
            and found.level == DiagnosticStatus.WARN
            and "reads it as std_msgs/msg/Int32" in found.message
            and "compat:=smartlab" in found.message
        )

    ros.until(is_told, "what to do")
    del rate


def test_what_it_cannot_be_ends_the_node(start_node: Start) -> None:
    node = start_node("--ros-args", "-p", "compat:=smart")
    assert node.wait() == 2
    assert "compat" in node.log
