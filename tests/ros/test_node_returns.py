"""Streams vanish and return, also when the program that sends them is killed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pylsl
import pytest
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]


def declared(sensor_name: str, data: str, unit: str, who: str) -> Outlet:
    identity = DeviceIdentity(sensor_name, unit, participant=who)
    return Outlet(declaration(sensor_name).stream(data), identity, DeviceInfo())


def foreign(name: str, source_id: str) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 0.0, "float32", source_id))


@pytest.mark.seam
def test_an_outlet_that_returns_is_attached_again(ros: Ros) -> None:
    topic = "/back/biosensors/polar_h10/ecg"
    assert ros.set("back.polar_h10.Chunk_Length", 4) == ""
    outlet = declared("polar_h10", "ecg", "U1", who="back")
    raw = ros.listen(Float32, topic)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk")
    ros.attached(topic, readers=2)
    now = pylsl.local_clock()
    assert outlet.push(range(6), [now + number / 130 for number in range(6)]) is None
    ros.until(lambda: len(raw) == 6 and len(chunks) == 1, "six samples and a chunk")
    del outlet
    ros.until(lambda: topic not in ros.present(), "its end")
    outlet = declared("polar_h10", "ecg", "U1", who="back")
    ros.attached(topic, readers=2)
    now = pylsl.local_clock()
    assert outlet.push(range(10, 14), [now + number / 130 for number in range(4)]) is None
    ros.until(lambda: len(raw) >= 10 and len(chunks) >= 2, "four more samples and a chunk")
    assert [message.data for message in raw] == [0, 1, 2, 3, 4, 5, 10, 11, 12, 13]
    assert [list(chunk.data) for chunk in chunks] == [[0, 1, 2, 3], [10, 11, 12, 13]]
    ros.report()
    status = ros.status(topic)
    assert status is not None
    assert (status["received"], status["chunk_discarded"]) == ("10", "2")


def test_a_program_that_starts_with_a_new_source_id_keeps_its_topic(ros: Ros) -> None:
    topic = "/biosensors/restarted/EEG"
    heard = ros.listen(Float32MultiArray, topic)
    for source_id in ("run 1", "run 2", ""):
        outlet = foreign("restarted", source_id)
        ros.attached(topic, readers=1)
        outlet.push_sample([1.0], pylsl.local_clock())
        heard.clear()
        ros.until(lambda: bool(heard), f"a sample under the id {source_id!r}")
        del outlet
        ros.until(lambda: topic not in ros.present(), "its end")
