"""``/diagnostics`` and the agent's counters: what arrived, what is missing, and since when."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from biosensor_common.naming import TopicName
from biosensor_common.quantities import Category, ChannelFormat, MessageType
from biosensor_common.registry import sensor
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.outlets import Counters, Outlet, counters_text
from lsl_to_ros.bridge import Bridge, Tally
from lsl_to_ros.diagnostics import RateMeter, stream_status
from lsl_to_ros.losses import LossAccount
from lsl_to_ros.parameters import StreamSettings

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

COUNTERS = "/biosensors/gateway/counters"
NAME = TopicName("biosensors/zephyr", "ecg")


@dataclass
class Topic:
    topic_name: str = "/biosensors/zephyr/ecg"

    def publish(self, msg: Any) -> None:
        pass

    def get_subscription_count(self) -> int:
        return 2


Make = Callable[..., Bridge]


@pytest.fixture
def make() -> Make:
    def bridge(rate: float = 100.0, *, foreign: bool = False) -> Bridge:
        header = StreamHeader(
            identity=DeviceIdentity("zephyr", "BH1", "p01", "left"),
            data_name="ecg",
            category=Category.RAW,
            content_type="ECG",
            labels=("a", "b"),
            units=("g", "g"),
            rate=rate,
            format=ChannelFormat.FLOAT32,
            message_type=MessageType.FLOAT32_MULTI_ARRAY,
            chunk="",
            foreign=foreign,
        )
        settings = StreamSettings(raw=True, chunk=True, chunk_length=8)
        account, tally = LossAccount(), Tally()
        return Bridge(
            header, Topic(), None, settings, account, tally, lambda _: Time(), lambda _: None
        )

    return bridge


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {entry.key: entry.value for entry in status.values}


def describe(bridge: Bridge, topic: TopicName = NAME, age: float = 0.1) -> DiagnosticStatus:
    return stream_status(topic, bridge, 99.5, age, None)


def test_a_streaming_stream_is_ok(make: Make) -> None:
    bridge = make()
    bridge.receive([1.0, 2.0], 10.0)
    status = describe(bridge)
    assert (status.level, status.message) == (DiagnosticStatus.OK, "streaming")
    assert status.name == "lsl_to_ros: /biosensors/zephyr/ecg"
    assert status.hardware_id == "BH1"
    shown = values(status)
    assert (shown["sensor"], shown["participant"], shown["label"]) == ("zephyr", "p01", "left")
    assert shown["unit_of_measurement"] == "g"
    assert (shown["rate_measured"], shown["rate_nominal"]) == ("99.50", "100.00")
    assert (shown["received"], shown["subscribers"]) == ("1", "2")
    assert shown["clock_offset_s"] == ""


def test_a_regular_stream_without_samples_is_stale_an_irregular_one_is_not(make: Make) -> None:
    assert describe(make()).level == DiagnosticStatus.STALE
    bridge = make()
    bridge.receive([1.0, 2.0], 10.0)
    assert describe(bridge, age=60.0).level == DiagnosticStatus.STALE
    assert describe(make(rate=0.0), age=60.0).level == DiagnosticStatus.OK


def test_a_shared_name_is_an_error(make: Make) -> None:
    bridge = make()
    bridge.receive([1.0, 2.0], 10.0)
    conflict = describe(bridge, TopicName("biosensors/zephyr_BH1", "ecg", conflict=True))
    assert conflict.level == DiagnosticStatus.ERROR
    assert "label" in conflict.message
    duplicate = describe(bridge, TopicName("biosensors/zephyr", "ecg", duplicate=True))
    assert duplicate.level == DiagnosticStatus.ERROR


def test_samples_that_do_not_fit_are_a_warning(make: Make) -> None:
    bridge = make()
    bridge.receive([1.0, 2.0], 10.0)
    bridge.tally.unfit = 3
    status = describe(bridge)
    assert status.level == DiagnosticStatus.WARN
    assert values(status)["unfit"] == "3"


def test_what_is_lost_is_counted_estimated_or_unknown_but_never_made_up(make: Make) -> None:
    ours = make()
    assert values(describe(ours))["lost"] == "unknown"
    ours.account.reported(0, 4, 0.0)
    assert values(describe(ours))["lost"] == "4"
    assert values(describe(make(rate=0.0, foreign=True)))["lost"] == "unknown"
    foreign = make(foreign=True)
    foreign.receive([1.0, 2.0], 10.0)
    foreign.receive([1.0, 2.0], 10.5)
    assert values(describe(foreign))["lost"] == "about 49"


def test_the_rate_is_measured_from_sample_to_sample() -> None:
    meter = RateMeter()
    assert meter.rate(0, 0.0) == 0.0
    assert meter.rate(10, 100.0) == 0.0
    assert meter.rate(10, 100.0) == 0.0
    assert meter.rate(260, 101.0) == pytest.approx(250.0)


@pytest.fixture
def counters(node: RunningNode, ros: Ros) -> Outlet:
    assert node.is_running
    ros.until(lambda: COUNTERS not in ros.present(), "the end of the counters before")
    identity = DeviceIdentity("gateway", "lab-pc")
    return Outlet(sensor("gateway").stream("counters"), identity, DeviceInfo())


def test_the_agents_counters_are_published_and_compared(ros: Ros, counters: Outlet) -> None:
    topic = "/counted/biosensors/polar_h10/hr"
    identity = DeviceIdentity("polar_h10", "U1", participant="counted")
    outlet = Outlet(sensor("polar_h10").stream("hr"), identity, DeviceInfo())
    heard = ros.listen(DiagnosticArray, COUNTERS)
    ros.attached(topic)
    ros.attached(COUNTERS, readers=1)
    status = ros.status(topic)
    assert status is not None
    assert status["lost"] == "unknown"

    def push(value: float) -> None:
        assert outlet.push([value], [pylsl.local_clock()]) is None

    def report(device: int, transport: int) -> None:
        """Report what was pushed, and more that a broken network would have lost."""
        count = outlet.counters
        said = Counters(pushed=count.pushed + transport, lost=device, last_stamp=count.last_stamp)
        counters.push_text(counters_text({outlet.source_id: said}), pylsl.local_clock())

    def shows(lost: str) -> bool:
        status = ros.status(topic)
        return status is not None and status["lost"] == lost

    push(60.0)
    report(device=2, transport=0)
    push(61.0)
    ros.until(lambda: shows("2"), "what the device lost")
    report(device=3, transport=5)
    push(62.0)
    ros.until(lambda: shows("8"), "what device and transport lost")

    system_s, lsl_s = time.time(), pylsl.local_clock()
    seen = len(heard)
    counters.push_text(counters_text({outlet.source_id: outlet.counters}), lsl_s)
    ros.until(lambda: len(heard) > seen, "the counters on their topic")
    stamp = heard[-1].header.stamp
    assert stamp.sec + stamp.nanosec * 1e-9 == pytest.approx(system_s, abs=0.05)
    (entry,) = heard[-1].status
    assert entry.name == outlet.source_id
    assert float(values(entry)["pushed"]) == outlet.counters.pushed == 3


def test_counters_of_unknown_streams_are_of_no_consequence(ros: Ros, counters: Outlet) -> None:
    heard = ros.listen(DiagnosticArray, COUNTERS)
    ros.attached(COUNTERS, readers=1)
    unknown = {"nobody's": Counters(pushed=5, lost=1, last_stamp=2.0)}
    counters.push_text(counters_text(unknown), pylsl.local_clock())
    ros.until(lambda: bool(heard), "the counters on their topic")
    assert heard[-1].status[0].name == "nobody's"
