"""What the running node tells of itself: ``/diagnostics``, ``~/streams`` and its log."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode, Status

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

Begin = Callable[..., "Flow"]

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)
STALE_S = 5.0
LOG_LINES, LOG_WINDOW_S = 200, 10.0
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CHEST = DeviceIdentity("polar_h10", "H1", participant="p02", label="chest")
BASE = "/p02/biosensors/polar_h10_chest"


def foreign(name: str, rate: float = 100.0, source_id: str | None = None) -> pylsl.StreamOutlet:
    given = f"id of {name}" if source_id is None else source_id
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, rate, "float32", given))


def declared(identity: DeviceIdentity, data: str) -> Outlet:
    return Outlet(declaration(identity.sensor).stream(data), identity, DeviceInfo())


def unchecked(outlet: Outlet) -> pylsl.StreamOutlet:
    return vars(outlet)["_outlet"]


def status_of(ros: Ros, topic: str) -> Status:
    status = ros.status(topic)
    assert status is not None, topic
    return status


def test_the_status_of_a_stream_says_everything_about_it(ros: Ros, flow: Begin) -> None:
    ecg = declared(CHEST, "ecg")
    agent = declared(DeviceIdentity("gateway", "agent"), "counters")
    heard = ros.listen(Float32, f"{BASE}/ecg")
    assert ros.set("p02.polar_h10_chest.Chunk_Length", 10) == ""
    ros.attached(f"{BASE}/ecg", readers=1)
    ros.attached("/biosensors/gateway/counters")
    before = status_of(ros, f"{BASE}/ecg")
    assert (before.level, before.message, before["age_s"]) == (STALE, "no samples", "")
    assert before["lost"] == "unknown"
    assert [before[f"latency_{which}_s"] for which in ("mean", "max")] == ["", ""]
    flowing = flow(unchecked(ecg), 130.0)
    ros.until(lambda: len(heard) > 300, "two seconds of samples")
    # A report after the last sample tells of none.
    ros.until(lambda: status_of(ros, f"{BASE}/ecg")["latency_mean_s"] != "", "a latency")
    latest = status_of(ros, f"{BASE}/ecg")
    assert 0.0 <= float(latest["latency_mean_s"]) <= float(latest["latency_max_s"]) < 10.0
    count = flowing.stop()
    # Their stamps go on evenly, or the rate were another one; none is of the future.
    ros.until(lambda: pylsl.local_clock() > flowing.stamp(count + 2), "two samples more are due")
    for number in (count, count + 1):
        # The agent says what it has pushed; a later sample shows that nothing is on its way.
        counters = Counters(pushed=number, lost=3, last_stamp=flowing.stamp(number))
        agent.push_text(counters_text({ecg.source_id: counters}), flowing.stamp(number))
        unchecked(ecg).push_sample([0.0], flowing.stamp(number + 1))

    def has_all() -> bool:
        status = status_of(ros, f"{BASE}/ecg")
        found = tuple(status[key] for key in ("lost", "received", "waiting"))
        return found == ("3", str(count + 2), "0")

    ros.until(has_all, "the agent's loss and all samples, of which none waits")
    status = status_of(ros, f"{BASE}/ecg")
    assert (status.level, status.message) == (WARN, "3 samples lost in the last 10 s")
    assert status.unit == "H1"
    for key in ("latency_mean_s", "latency_max_s"):
        del status.values[key]
    measured = {key: float(status.values.pop(key)) for key in MEASURED}
    assert status.values == {
        "topic": f"{BASE}/ecg",
        "replay_of": "",
        "chunk_topic": f"{BASE}/ecg_chunk",
        "sensor": "polar_h10",
        "participant": "p02",
        "label": "chest",
        "unit_of_measurement": "microvolts",
        "rate_nominal": "130.00",
        "received": str(count + 2),
        "lost": "3",
        "sent_before": "0",
        "unfit": "0",
        "unstamped": "0",
        "refusals": "",
        "chunk_discarded": status["chunk_discarded"],
        "published": str(count + 2),
        "waiting": "0",
        "unsent": "0",
        "not_taken": "0",
        "subscribers": "1",
    }
    assert measured["rate_measured"] == pytest.approx(130.0, rel=0.05)
    assert 0.0 <= measured["age_s"] < 10.0
    assert 0.0 <= measured["queue_age_s"] < 10.0
    # One machine has one LSL clock.
    assert abs(measured["clock_offset_s"]) < 1e-3
    assert 0.0 <= measured["clock_offset_spread_s"] < 1e-3


MEASURED = (
    "rate_measured",
    "age_s",
    "queue_age_s",
    "clock_offset_s",
    "clock_offset_spread_s",
)


def test_the_status_of_a_device_tells_of_battery_and_contact(ros: Ros) -> None:
    outlets = {data: unchecked(declared(CHEST, data)) for data in ("bat", "quality", "rssi")}
    ros.attached(*(f"{BASE}/{data}" for data in outlets))
    device = "device p02/polar_h10_chest"
    for sent, level, message in (
        ({"bat": 80.0, "quality": 1.0, "rssi": -60.0}, OK, "as its streams report"),
        ({"bat": 10.0}, WARN, "battery at 10 %"),
        ({"bat": 55.0, "quality": 0.0}, WARN, "not worn"),
        ({"quality": 1.0}, OK, "as its streams report"),
    ):
        for data, value in sent.items():
            outlets[data].push_sample([value], pylsl.local_clock())

        def is_so(level: bytes = level, message: str = message) -> bool:
            status = ros.status(device)
            return status is not None and (status.level, status.message) == (level, message)

        ros.until(is_so, message)
    status = status_of(ros, device)
    assert status.unit == "H1"
    assert status.values == {"bat/level": "55", "quality/contact": "1", "rssi/signal": "-60"}


def test_the_status_of_the_node_warns_once_that_stamped_topics_are_missing(
    ros: Ros, node: RunningNode
) -> None:
    outlets = [
        foreign("usable", 0.0),
        pylsl.StreamOutlet(pylsl.StreamInfo("unusable", "EEG", 0, 0.0, "float32", "unusable")),
    ]
    ros.attached("/biosensors/usable/EEG")
    ros.until(lambda: status_of(ros, "node")["streams_refused"] == "1", "a stream refused")
    status = status_of(ros, "node")
    for measured in ("cpu_percent", "queue_age_s", "computer_busy"):
        del status.values[measured]
    others = len([topic for topic in ros.present() if topic.startswith("/")])
    assert status.level == WARN
    assert "biosensor_msgs is not installed" in status.message
    assert status.values == {
        "streams": str(others),
        "streams_refused": "1",
        "streams_left_out": "0",
        "clock_steps": "0",
        # What it is set to, so that a bag tells why types differ (docs/migration.md).
        "compat": "",
        "stamped_topics": "no",
        "liblsl": str(pylsl.library_version()),
    }
    assert node.count("biosensor_msgs is not installed") == 1
    del outlets


@pytest.mark.seam
def test_levels_follow_what_happens_to_a_stream(ros: Ros, flow: Begin, kept: list[object]) -> None:
    names = ("steady", "quiet", "slow", "lossy", "clock", "clock_ends", "late", "rare")
    topics = {name: f"/biosensors/{name}/EEG" for name in names}
    outlets = {name: foreign(name, 0.0 if name == "rare" else 100.0) for name in names}
    kept.extend(outlets.values())
    ros.attached(*topics.values())
    flows = {name: flow(outlets[name], 80.0 if name == "slow" else 100.0) for name in names[:4]}
    begun = time.monotonic()

    # Unix time instead of the LSL clock's, and a device whose samples take 10 s.
    clocks: dict[str, Callable[[], float]] = {
        "clock": time.time,
        "clock_ends": time.time,
        "late": lambda: pylsl.local_clock() - 10.0,
    }

    def wait(name: str, level: bytes, *parts: str) -> None:
        def is_so() -> bool:
            for other, clock in clocks.items():
                outlets[other].push_sample([0.0], clock())
            status = status_of(ros, topics[name])
            return status.level == level and all(part in status.message for part in parts)

        ros.until(is_so, f"{name}: {parts}")

    outlets["rare"].push_sample([0.0], pylsl.local_clock())
    for name in (*names[:4], "rare"):
        wait(name, OK, "streaming")
    flows["lossy"].stop()
    stopped = time.monotonic()
    flows["quiet"].stop()
    for name in ("clock", "clock_ends"):
        wait(name, WARN, "not times of the LSL clock")
    del clocks["clock_ends"]
    ros.spin(0.5)
    flow(outlets["lossy"], 100.0)
    wait("lossy", WARN, "samples lost in the last 10 s")
    lost = int(status_of(ros, topics["lossy"])["lost"].removeprefix("about "))
    assert 100 * (time.monotonic() - stopped) >= lost > 10
    wait("quiet", STALE, "no samples")
    assert time.monotonic() - stopped > STALE_S - 0.5
    flow(outlets["quiet"], 100.0)
    wait("quiet", WARN, "samples lost")
    wait("slow", WARN, "80.", "Hz instead of 100.00 Hz")
    assert time.monotonic() - begun > 8.0
    for name in ("lossy", "quiet"):
        wait(name, OK, "streaming")
    for name in ("steady", "rare"):
        wait(name, OK, "streaming")
    wait("clock", WARN, "not times of the LSL clock")
    assert status_of(ros, topics["late"]).level != STALE
    # It ended long ago, whatever clock it had.
    wait("clock_ends", STALE, "no samples")


def test_streams_that_claim_one_name_are_an_error(ros: Ros) -> None:
    # Without a source_id, they differ in nothing at all.
    same = [foreign("same", source_id="") for _ in range(2)]
    units = [foreign("units", source_id=f"unit {number}") for number in (1, 2)]
    topics = [f"/biosensors/units_unit_x20{number}/EEG" for number in (1, 2)]
    ros.until(lambda: {"/biosensors/same/EEG", *topics} <= ros.present(), "all of them")
    for topic, part in (
        ("/biosensors/same/EEG", "two streams"),
        *((one, "label") for one in topics),
    ):
        ros.until(lambda topic=topic: status_of(ros, topic).level == ERROR, f"{topic}: an error")
        assert part in status_of(ros, topic).message
    del same, units


@pytest.mark.seam
def test_the_list_of_streams_says_where_each_comes_from_and_goes_to(ros: Ros) -> None:
    identity = DeviceIdentity("polar_h10", "H9", participant="p03", label="belt")
    ours, other = declared(identity, "ecg"), foreign("listed", 25.0)
    lists = ros.listen(DiagnosticArray, "/lsl_to_ros/streams", LATCHED)
    topics = ["/p03/biosensors/polar_h10_belt/ecg", "/biosensors/listed/EEG"]

    def entries() -> dict[str, Any]:
        return {status.name: status for status in lists[-1].status} if lists else {}

    ros.until(lambda: set(topics) <= set(entries()), "both")
    entry = entries()[topics[0]]
    facts = {item.key: item.value for item in entry.values}
    assert entry.hardware_id == "H9"
    assert facts.pop("uid")
    assert facts == {
        "lsl_name": ours.name,
        "lsl_type": "ECG",
        "source_id": ours.source_id,
        "host": socket.gethostname(),
        "rate": "130",
        "format": "float32",
        "labels": "ECG",
        "units": "microvolts",
        "participant": "p03",
        "label": "belt",
        "foreign": "false",
        f"topic {topics[0]}": "std_msgs/msg/Float32",
        f"topic {topics[0]}_chunk": "std_msgs/msg/Float32MultiArray",
    }
    facts = {item.key: item.value for item in entries()[topics[1]].values}
    assert (facts["lsl_name"], facts["foreign"], facts["rate"]) == ("listed", "true", "25")
    assert facts[f"topic {topics[1]}"] == "std_msgs/msg/Float32MultiArray"
    assert ros.set("topic_prefix", "elsewhere") == ""
    ros.until(lambda: "/elsewhere/listed/EEG" in entries(), "the new topic")
    assert not [name for name in entries() if "/biosensors/" in name]
    assert ros.set("topic_prefix", "biosensors") == ""
    del other
    ros.until(lambda: topics[1] not in entries(), "its end")
    assert topics[0] in entries()


def test_the_log_says_a_thing_once_and_how_much_was_held_back(ros: Ros, node: RunningNode) -> None:
    outlets = [foreign(f"logged_{number}") for number in range(6)]
    ros.attached(*(f"/biosensors/logged_{number}/EEG" for number in range(6)))
    # Two lines a stream in turn, ten times.
    for _ in range(10):
        for prefix in ("log_a", "log_b"):
            assert ros.set("topic_prefix", prefix) == ""
    for number in range(6):
        for prefix in ("log_a", "log_b"):
            assert node.count(f"{prefix}/logged_{number}/EEG") == 1
    # And more of different lines than anybody could read.
    begun = time.monotonic()
    for number in range(80):
        assert ros.set("topic_prefix", f"flood_{number}") == ""
    windows = (time.monotonic() - begun) / LOG_WINDOW_S
    assert node.count("flood_") <= LOG_LINES * (windows + 1)
    assert node.count("lines were suppressed)") >= 1
    assert ros.set("topic_prefix", "biosensors") == ""
    del outlets
