"""Several devices of one kind, and streams that claim to be the same one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]


def declared(sensor_name: str, data: str, unit: str, who: str = "", label: str = "") -> Outlet:
    identity = DeviceIdentity(sensor_name, unit, participant=who, label=label)
    return Outlet(declaration(sensor_name).stream(data), identity, DeviceInfo())


def foreign(name: str, kind: str, channels: int, source_id: str) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, kind, channels, 0.0, "float32", source_id))


def numbers(messages: list[Any]) -> set[float]:
    return {message.data for message in messages}


def flow(ros: Ros, outlet: Outlet, value: float, arrived: Callable[[], bool]) -> int:
    """Push one value until it arrives; return how often it was pushed."""
    pushes = count()

    def push_and_look() -> bool:
        if arrived():
            return True
        next(pushes)
        assert outlet.push([value], [pylsl.local_clock()]) is None
        return False

    ros.until(push_and_look, f"{value} on its topic")
    return next(pushes)


def test_a_replaced_device_continues_the_stream_of_its_place(ros: Ros) -> None:
    topic = "/p09/biosensors/polar_h10_chest/hr"
    heard = ros.listen(Float32, topic)
    for unit, value in (("OLD", 61.0), ("NEW", 62.0)):
        outlet = declared("polar_h10", "hr", unit, who="p09", label="chest")
        flow(ros, outlet, value, lambda value=value: value in numbers(heard))
        ros.report()
        status = ros.status(topic)
        assert status is not None
        assert (status.level, status.unit) == (DiagnosticStatus.OK, unit)
        del outlet
    assert numbers(heard) == {61.0, 62.0}


def test_streams_of_one_program_may_share_a_source_id(ros: Ros) -> None:
    kinds = ("EEG", "PPG", "ACC")
    heard = {kind: ros.listen(Float32MultiArray, f"/biosensors/headband/{kind}") for kind in kinds}
    outlets = {kind: foreign("headband", kind, 1, "headband 00:11") for kind in kinds}
    ros.attached(*(f"/biosensors/headband/{kind}" for kind in kinds), readers=1)
    for number, kind in enumerate(kinds):
        outlets[kind].push_sample([float(number)], pylsl.local_clock())
    ros.until(lambda: all(heard.values()), "a sample of each")
    assert [heard[kind][0].data[0] for kind in kinds] == [0.0, 1.0, 2.0]


def test_each_of_several_streams_that_claim_to_be_one_has_a_topic(
    ros: Ros, node: RunningNode
) -> None:
    topics = [f"/biosensors/twin/EEG{end}" for end in ("", "_2", "_3")]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    outlets: list[pylsl.StreamOutlet] = []

    def each_arrives() -> bool:
        for number, outlet in enumerate(outlets):
            outlet.push_sample([float(number)], pylsl.local_clock())
        return all(heard[: len(outlets)])

    for _ in topics:
        # One after the other, so that each has the next number.
        outlets.append(foreign("twin", "EEG", 1, "twin id"))
        ros.until(each_arrives, "a sample of each")
    assert [{message.data[0] for message in each} for each in heard] == [{0.0}, {1.0}, {2.0}]

    def are_told() -> bool:
        told = [ros.status(topic) for topic in topics]
        return all(
            each is not None
            and each.level == DiagnosticStatus.WARN
            and "3 senders have the same source_id" in each.message
            for each in told
        )

    ros.until(are_told, "a warning of each topic")


VALUES = {"A": 1.0, "B": 2.0}
# A capital starts the unit of that name, a small letter stops it.
ORDERS = [
    ("AB", "polar_h10", "ibi"),
    ("BA", "zephyr", "ibi"),
    ("AaB", "shimmer3_gsr", "hr"),
    ("ABaA", "empatica_e4", "ibi"),
    ("ABabBA", "ble_heart_rate", "ibi"),
]


class Pair:
    """Two units of one sensor without labels, started and stopped in some order."""

    def __init__(self, ros: Ros, steps: str, name: str, data: str) -> None:
        self.steps = steps
        self.bare = f"/biosensors/{name}/{data}"
        self.own = {unit: f"/biosensors/{name}_{unit}/{data}" for unit in VALUES}
        self.heard = {
            topic: ros.listen(Float32, topic) for topic in (self.bare, *self.own.values())
        }
        self.running: dict[str, Outlet] = {}
        self._name, self._data = name, data

    def begin(self, number: int) -> None:
        step = self.steps[number : number + 1]
        if step.isupper():
            self.running[step] = declared(self._name, self._data, step)
        elif step:
            del self.running[step.upper()]
        self.topics = {unit: self.own[unit] if number else self.bare for unit in self.running}
        for topic in self.topics.values():
            self.heard[topic].clear()

    def is_done(self, present: set[str]) -> bool:
        """Whether the present units, and no others, are on their topics."""
        for unit, outlet in self.running.items():
            assert outlet.push([VALUES[unit]], [pylsl.local_clock()]) is None
        mine = {self.bare, *self.own.values()} & present
        return mine == set(self.topics.values()) and all(map(self.heard.get, mine))


def test_data_of_one_unit_never_appears_under_the_topic_of_another(ros: Ros) -> None:
    pairs = [Pair(ros, *order) for order in ORDERS]
    for number in range(max(len(pair.steps) for pair in pairs)):
        for pair in pairs:
            pair.begin(number)
        ros.until(
            lambda: all(pair.is_done(ros.present()) for pair in pairs), f"step {number} of each"
        )
    for pair in pairs:
        ros.until(lambda bare=pair.bare: ros.node.count_publishers(bare) == 0, "its end")
        assert numbers(pair.heard[pair.bare]) == {VALUES[pair.steps[0]]}
        for unit, topic in pair.own.items():
            assert numbers(pair.heard[topic]) <= {VALUES[unit]}
        for unit in pair.running:
            status = ros.status(pair.own[unit])
            assert status is not None
            assert status.level == DiagnosticStatus.ERROR
            assert "label" in status.message


@pytest.mark.seam
def test_labels_and_participants_keep_devices_of_a_kind_apart(ros: Ros) -> None:
    places = [("", "left"), ("", "right"), ("p01", ""), ("p02", ""), ("p01", "left")]
    topics = [
        "/biosensors/empatica_e4_left/hr",
        "/biosensors/empatica_e4_right/hr",
        "/p01/biosensors/empatica_e4/hr",
        "/p02/biosensors/empatica_e4/hr",
        "/p01/biosensors/empatica_e4_left/hr",
    ]
    outlets = [
        declared("empatica_e4", "hr", f"U{number}", who, label)
        for number, (who, label) in enumerate(places)
    ]
    heard = [ros.listen(Float32, topic) for topic in topics]
    for number, outlet in enumerate(outlets):
        flow(ros, outlet, float(number), lambda number=number: bool(heard[number]))
    ros.report()
    for number, topic in enumerate(topics):
        assert numbers(heard[number]) == {float(number)}
        status = ros.status(topic)
        assert status is not None
        assert status.level == DiagnosticStatus.OK
