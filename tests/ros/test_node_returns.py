"""Streams vanish and return, and devices of a kind come and go in any order."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.registry import sensor
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.usefixtures("node")


def declared(sensor_name: str, data: str, unit: str, who: str = "", label: str = "") -> Outlet:
    identity = DeviceIdentity(sensor_name, unit, participant=who, label=label)
    return Outlet(sensor(sensor_name).stream(data), identity, DeviceInfo())


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


def test_a_stream_with_another_channel_count_is_never_published_in_a_wrong_shape(
    ros: Ros, node: RunningNode
) -> None:
    topic = "/biosensors/shape/EEG"
    heard = ros.listen(Float32MultiArray, topic)
    for channels in (2, 5, 3):
        outlet = foreign("shape", "EEG", channels, "one id")
        seen = len(heard)

        def arrived(seen: int = seen) -> bool:
            return len(heard) > seen

        def push(outlet: pylsl.StreamOutlet = outlet, channels: int = channels) -> bool:
            outlet.push_sample([float(channels)] * channels, pylsl.local_clock())
            return arrived()

        ros.until(push, f"a sample of {channels} channels")
        del outlet, push
    for message in heard:
        width = int(message.data[0])
        assert list(message.data) == [float(width)] * width
        assert message.layout.dim[0].size == width
    assert {len(message.data) for message in heard} == {2, 5, 3}
    assert node.count("reading it failed") == 0


def test_a_program_that_starts_with_a_new_source_id_keeps_its_topic(ros: Ros) -> None:
    topic = "/biosensors/restarted/EEG"
    heard = ros.listen(Float32MultiArray, topic)
    for source_id in ("run 1", "run 2", ""):
        outlet = foreign("restarted", "EEG", 1, source_id)
        ros.attached(topic, readers=1)
        outlet.push_sample([1.0], pylsl.local_clock())
        heard.clear()
        ros.until(lambda: bool(heard), f"a sample under the id {source_id!r}")
        del outlet
        ros.until(lambda: topic not in ros.present(), "its end")


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
    for kind in kinds:
        ros.attached(f"/biosensors/headband/{kind}", readers=1)
    for number, kind in enumerate(kinds):
        outlets[kind].push_sample([float(number)], pylsl.local_clock())
    ros.until(lambda: all(heard.values()), "a sample of each")
    assert [heard[kind][0].data[0] for kind in kinds] == [0.0, 1.0, 2.0]


def test_of_streams_that_claim_to_be_one_the_newest_stays_and_the_log_says_so(
    ros: Ros, node: RunningNode
) -> None:
    topic = "/biosensors/twin/EEG"
    heard = ros.listen(Float32MultiArray, topic)
    outlets: list[pylsl.StreamOutlet] = []

    def newest_arrives() -> bool:
        for number, outlet in enumerate(outlets):
            outlet.push_sample([float(number)], pylsl.local_clock())
        return any(message.data[0] == len(outlets) - 1 for message in heard)

    for _ in range(3):
        outlets.append(foreign("twin", "EEG", 1, "twin id"))
        ros.until(newest_arrives, "a sample of the newest")
    said = ("[WARN]", "'twin'", "share a source_id")
    heard.clear()

    def both_are_said() -> bool:
        newest_arrives()
        return node.count(*said) >= 2

    ros.until(both_are_said, "a warning of each twin that is left out")
    assert {message.data[0] for message in heard} == {2.0}
    assert node.count(*said) == 2


STEPS = ["AB", "BA", "AaB", "ABaA", "ABabBA"]
SENSORS = ["polar_h10", "zephyr", "shimmer3_gsr", "empatica_e4", "ble_heart_rate"]


@pytest.mark.parametrize(("steps", "name"), list(zip(STEPS, SENSORS, strict=True)))
def test_data_of_one_unit_never_appears_under_the_topic_of_another(
    ros: Ros, steps: str, name: str
) -> None:
    """A capital starts the unit of that name, a small letter stops it."""
    values = {"A": 1.0, "B": 2.0}
    bare = f"/biosensors/{name}/ibi"
    data = "ibi"
    if name == "shimmer3_gsr":
        bare, data = f"/biosensors/{name}/hr", "hr"
    own = {unit: f"/biosensors/{name}_{unit}/{data}" for unit in values}
    heard = {topic: ros.listen(Float32, topic) for topic in (bare, *own.values())}
    running: dict[str, Outlet] = {}
    for number, step in enumerate(steps):
        if step.islower():
            del running[step.upper()]
            ros.until(lambda step=step: own[step.upper()] not in ros.present(), "its end")
            ros.until(lambda: bare not in ros.present(), "the end of the bare topic")
            continue
        running[step] = declared(name, data, step)
        topic = own[step] if number else bare
        for messages in heard.values():
            messages.clear()
        flow(ros, running[step], values[step], lambda topic=topic: bool(heard[topic]))
        assert numbers(heard[topic]) == {values[step]}
        if number:
            assert heard[bare] == []
    for unit, outlet in running.items():
        heard[own[unit]].clear()
        flow(ros, outlet, values[unit], lambda unit=unit: bool(heard[own[unit]]))
        assert numbers(heard[own[unit]]) == {values[unit]}
        ros.report()
        status = ros.status(own[unit])
        assert status is not None
        assert status.level == DiagnosticStatus.ERROR
        assert "label" in status.message
    assert bare not in ros.present()
    ros.until(lambda: ros.node.count_publishers(bare) == 0, "the bare topic closed")


def test_labels_and_participants_keep_devices_of_a_kind_apart(ros: Ros) -> None:
    places = [("", "left"), ("", "right"), ("p01", ""), ("p02", ""), ("p01", "left")]
    topics = [
        "/biosensors/vernier_respiration_belt_left/bat",
        "/biosensors/vernier_respiration_belt_right/bat",
        "/p01/biosensors/vernier_respiration_belt/bat",
        "/p02/biosensors/vernier_respiration_belt/bat",
        "/p01/biosensors/vernier_respiration_belt_left/bat",
    ]
    outlets = [
        declared("vernier_respiration_belt", "bat", f"U{number}", who, label)
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
