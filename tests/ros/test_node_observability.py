"""What the running node tells of streams and devices that do well, fall silent or lie."""

from __future__ import annotations

import socket
import time
import uuid
from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile

from biosensor_common.registry import sensor
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.outlets import Outlet
from tests.ros.conftest import Flow

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

OK, WARN, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.STALE
RATE_HZ = 50.0
STALE_AFTER_S = 5.0
# Samples that one stream leaves out, by their numbers.
LEFT_OUT = range(101, 161)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# fmt: off
FIELDS = {
    "topic", "chunk_topic", "sensor", "participant", "label", "unit_of_measurement",
    "rate_measured", "rate_nominal", "received", "lost", "unfit", "unstamped", "chunk_discarded",
    "age_s", "latency_mean_s", "latency_max_s", "clock_offset_s", "clock_offset_spread_s",
    "subscribers",
}
# fmt: on


class LossyOutlet(pylsl.StreamOutlet):
    """Never pushes the samples of certain numbers."""

    def push_chunk(self, x: Any, timestamp: Any = 0.0, pushthrough: bool = True) -> None:
        kept = ~np.isin(x[:, 0], LEFT_OUT)
        if kept.any():
            super().push_chunk(x[kept], list(np.array(timestamp)[kept]), pushthrough)


class UnixTimeOutlet(pylsl.StreamOutlet):
    """Stamps with the seconds since 1970, as programs do that do not ask LSL for the time."""

    def push_chunk(self, x: Any, timestamp: Any = 0.0, pushthrough: bool = True) -> None:
        offset = time.time() - pylsl.local_clock()
        super().push_chunk(x, [stamp + offset for stamp in timestamp], pushthrough)


def describe(info: pylsl.StreamInfo, *channels: tuple[str, str]) -> None:
    """Add labels and units as the XDF format has them."""
    parent = info.desc().append_child("channels")
    for label, unit in channels:
        channel = parent.append_child("channel")
        channel.append_child_value("label", label)
        channel.append_child_value("unit", unit)


def announced(name: str, rate: float = RATE_HZ) -> pylsl.StreamInfo:
    info = pylsl.StreamInfo(name, "EEG", 1, rate, "float32", f"id of {name}")
    describe(info, ("AF3", "microvolts"))
    return info


def topic(name: str) -> str:
    return f"/biosensors/{name}/EEG"


class Report:
    """One stream's entry in one message of ``/diagnostics``."""

    def __init__(self, array: DiagnosticArray, status: DiagnosticStatus) -> None:
        self.time_s = array.header.stamp.sec + array.header.stamp.nanosec * 1e-9
        self.level, self.message = status.level, status.message
        self.values = {value.key: value.value for value in status.values}

    def number(self, key: str) -> float:
        return float(self.values[key])


class History:
    """All reports while streams did well, paused, lied and recovered, side by side."""

    def __init__(self, arrays: list[DiagnosticArray]) -> None:
        self._arrays = arrays

    def of(self, name: str, least: int = 1) -> list[Report]:
        """Reports of one stream in which it has had so many samples."""
        found = [
            Report(array, status)
            for array in self._arrays
            for status in array.status
            if status.name == f"lsl_to_ros: {topic(name)}"
        ]
        return [report for report in found if report.number("received") >= least]

    def levels(self, name: str) -> list[bytes]:
        """Levels in their order, each once as long as it lasts."""
        return [level for level, _ in groupby(report.level for report in self.of(name))]

    def is_at(self, name: str, level: bytes) -> bool:
        reports = self.of(name)
        return bool(reports) and reports[-1].level == level


@pytest.fixture(scope="module")
def history(listener: Ros, node: RunningNode) -> Iterator[History]:
    """Let all scenes happen at the same time, for each takes ten seconds or more."""
    arrays: list[DiagnosticArray] = listener.listen(DiagnosticArray, "/diagnostics")
    history = History(arrays)
    well, pausing = (pylsl.StreamOutlet(announced(name)) for name in ("well", "pausing"))
    slow = pylsl.StreamOutlet(announced("slow", 100.0))
    unix, lossy = UnixTimeOutlet(announced("unix")), LossyOutlet(announced("lossy"))
    names = ("well", "pausing", "slow", "unix", "lossy")
    listener.attached(*(topic(name) for name in names))
    flows = [Flow(well, RATE_HZ), Flow(slow, 80.0), Flow(unix, RATE_HZ), Flow(lossy, RATE_HZ)]
    flows.append(Flow(pausing, RATE_HZ))
    try:
        listener.until(lambda: history.is_at("pausing", OK), "the first samples")
        flows.pop().stop()
        listener.until(lambda: history.is_at("pausing", STALE), "the end of its samples")
        flows.append(Flow(pausing, RATE_HZ))
        listener.until(lambda: history.is_at("slow", WARN), "a wrong rate")
        listener.until(lambda: history.is_at("lossy", OK), "losses that are long ago")
        listener.until(lambda: history.is_at("pausing", OK), "a pause that is long ago")
        listener.stop_listening()
        yield history
    finally:
        for flow in flows:
            flow.stop()


def test_a_stream_that_does_well_is_always_ok(history: History) -> None:
    assert {(report.level, report.message) for report in history.of("well")} == {(OK, "streaming")}


def test_every_field_of_a_stream_is_there_and_true(history: History) -> None:
    report = history.of("well")[-1]
    values = report.values
    assert set(values) == FIELDS
    assert (values["topic"], values["chunk_topic"]) == (topic("well"), f"{topic('well')}_chunk")
    assert (values["sensor"], values["participant"], values["label"]) == ("well", "", "")
    assert values["unit_of_measurement"] == "microvolts"
    assert values["rate_nominal"] == "50.00"
    assert report.number("rate_measured") == pytest.approx(RATE_HZ, rel=0.01)
    assert values["lost"] == "about 0"
    for key in ("unfit", "unstamped", "chunk_discarded", "subscribers"):
        assert values[key] == "0"
    # Nobody reads it, so its samples are fetched ten times a second.
    assert 0.0 < report.number("latency_mean_s") <= report.number("latency_max_s") < STALE_AFTER_S
    assert 0.0 < report.number("age_s") < STALE_AFTER_S
    assert abs(report.number("clock_offset_s")) < 0.01
    assert 0.0 <= report.number("clock_offset_spread_s") < 0.01


def test_a_regular_stream_is_stale_after_five_seconds_of_silence_and_recovers(
    history: History,
) -> None:
    reports = history.of("pausing")
    # What did not come in the pause counts as lost for ten seconds.
    assert history.levels("pausing") == [OK, STALE, WARN, OK]
    for report in reports:
        assert (report.level == STALE) == (report.number("age_s") > STALE_AFTER_S)
    assert {report.message for report in reports if report.level == STALE} == {"no samples"}
    pause = next(report for report in reports if report.level == WARN)
    assert "samples lost in the last 10 s" in pause.message
    lost = float(pause.values["lost"].removeprefix("about "))
    assert lost > STALE_AFTER_S * RATE_HZ


def test_a_wrong_rate_is_a_warning_once_it_was_measured_for_ten_seconds(history: History) -> None:
    reports = history.of("slow")
    assert history.levels("slow") == [OK, WARN]
    first = next(report for report in reports if report.level == WARN)
    assert first.message == f"{first.values['rate_measured']} Hz instead of 100.00 Hz"
    assert first.number("rate_measured") == pytest.approx(80.0, rel=0.01)
    assert first.time_s - history.of("slow", least=0)[0].time_s > 8.0


def test_stamps_of_another_clock_are_a_warning(history: History) -> None:
    reports = history.of("unix")
    warning = (WARN, "its stamps are not times of the LSL clock")
    assert {(report.level, report.message) for report in reports} == {warning}
    assert reports[-1].number("rate_measured") == pytest.approx(RATE_HZ, rel=0.01)
    age = time.time() - pylsl.local_clock()
    assert reports[-1].number("age_s") == pytest.approx(-age, abs=120.0)


def test_samples_that_a_stream_leaves_out_are_a_warning_for_ten_seconds(history: History) -> None:
    reports = history.of("lossy")
    assert history.levels("lossy") == [OK, WARN, OK]
    warnings = [report for report in reports if report.level == WARN]
    missing = len(LEFT_OUT)
    assert {report.message for report in warnings} == {f"{missing} samples lost in the last 10 s"}
    # Reports are a second apart, so the ten seconds are met to two of them.
    assert 7.0 < warnings[-1].time_s - warnings[0].time_s < 11.0
    assert reports[-1].values["lost"] == f"about {missing}"


def test_missing_messages_for_stamps_are_a_warning_and_said_once(
    ros: Ros, node: RunningNode, history: History
) -> None:
    ros.report()
    status = ros.status("node")
    assert status is not None
    assert (status.level, status["stamped_topics"]) == (WARN, "no")
    assert "biosensor_msgs is not installed" in status.message
    assert node.count("[WARN]", "biosensor_msgs is not installed") == 1
    assert not any(name.endswith("_stamped") for name in ros.topics())
    attached = {name for name in ros.present() if name.startswith("/biosensors/")}
    assert status["streams"] == str(len(attached))
    assert status["streams_refused"] == "0"


def strap(data: str, participant: str) -> Outlet:
    identity = DeviceIdentity("polar_h10", f"unit of {participant}", participant=participant)
    return Outlet(sensor("polar_h10").stream(data), identity, DeviceInfo())


def test_a_device_that_is_empty_or_not_worn_is_a_warning_until_it_is_mended(
    ros: Ros, node: RunningNode
) -> None:
    tired, slipped = strap("bat", "tired"), strap("quality", "slipped")
    steps: list[tuple[Outlet, str, str, float, bytes, str]] = [
        (tired, "tired", "bat/level", 5.0, WARN, "battery at 5 %"),
        (tired, "tired", "bat/level", 10.0, WARN, "battery at 10 %"),
        (tired, "tired", "bat/level", 11.0, OK, "as its streams tell"),
        (slipped, "slipped", "quality/contact", 0.0, WARN, "not worn"),
        (slipped, "slipped", "quality/contact", 1.0, OK, "as its streams tell"),
    ]
    for outlet, who, key, value, level, message in steps:
        assert outlet.push([value], [pylsl.local_clock()]) is None
        expected = (level, message, f"unit of {who}", {key: f"{value:g}"})

        def is_told(outlet: Outlet = outlet, who: str = who, expected: object = expected) -> bool:
            # The first value of a state waits for its receivers.
            outlet.release()
            status = ros.status(f"device {who}/polar_h10")
            return status is not None and expected == (
                status.level,
                status.message,
                status.unit,
                status.values,
            )

        ros.until(is_told, f"{expected}")


def entries(arrays: list[DiagnosticArray]) -> dict[str, dict[str, str]]:
    """Return the facts of each stream by its topic, from the latest list."""
    found = arrays[-1].status if arrays else []
    return {one.name: {value.key: value.value for value in one.values} for one in found}


def test_the_list_of_streams_is_latched_and_follows_what_comes_and_goes(
    ros: Ros, node: RunningNode
) -> None:
    info = pylsl.StreamInfo("listed", "Gaze", 2, 60.0, "double64", "id of listed")
    describe(info, ("x", "pixels"), ("y", "pixels"))
    outlet = pylsl.StreamOutlet(info)
    name = "/biosensors/listed/Gaze"
    ros.attached(name)
    lists: list[DiagnosticArray] = ros.listen(DiagnosticArray, "/lsl_to_ros/streams", LATCHED)
    ros.until(lambda: bool(lists), "the list for a subscriber that comes late")
    listed = entries(lists)[name]
    uid = listed.pop("uid")
    assert str(uuid.UUID(uid)) == uid
    kind = "std_msgs/msg/Float64MultiArray"
    expected = {
        "lsl_name": "listed",
        "lsl_type": "Gaze",
        "source_id": "id of listed",
        "host": socket.gethostname(),
        "rate": "60",
        "format": "double64",
        "labels": "x, y",
        "units": "pixels, pixels",
        "participant": "",
        "label": "",
        "foreign": "true",
        f"topic {name}": kind,
        f"topic {name}_chunk": kind,
    }
    assert listed == expected
    staying = pylsl.StreamOutlet(announced("comes"))
    ros.until(lambda: topic("comes") in entries(lists), "a stream that comes")
    assert entries(lists)[name] == {**expected, "uid": uid}
    del outlet
    ros.until(lambda: name not in entries(lists), "a stream that goes")
    assert topic("comes") in entries(lists)
    assert staying.have_consumers()
