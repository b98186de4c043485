"""``/diagnostics`` and the status of each device: what arrived, and what its streams tell."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Float32MultiArray

from biosensor_common.lsl.inlet import Block
from biosensor_common.naming import TopicName
from biosensor_common.quantities import ChannelFormat, ChannelRole, ContentType, MessageType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.messages import AgentSays, said_of_streams
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import STALE_AFTER_S, StreamHeader
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.reports import diagnostics
from lsl_to_ros.reports.diagnostics import StreamStatus, stream_facts, stream_status
from lsl_to_ros.reports.reporter import LOW_BATTERY_PERCENT, StreamOfDevice, device_statuses
from lsl_to_ros.statistics import status as stream_status_module
from lsl_to_ros.statistics.losses import NodeCounters
from lsl_to_ros.statistics.status import RATE_WINDOW_S
from lsl_to_ros.topics.bridge import Bridge, Outputs
from lsl_to_ros.topics.writers import ChunkWriter, NumberWriter
from tests.rigs.recorded_topics import Clocks, RecordedPublisher, header_of
from tests.rigs.virtual_time import SetClock

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

# ``/diagnostics`` and the agent's counters: what arrived, what is missing, and since when.

COUNTERS = "/biosensors/gateway/counters"
NAME = TopicName("p01/biosensors/zephyr_left", "acc")
HEADER = header_of("zephyr", "acc", participant="p01", label="left", rate=100.0, chunk="acc")
SETTINGS = StreamSettings(raw=True, chunk=True, chunk_length=8)


class Stream:
    """One stream, looked at by ``/diagnostics`` once a second."""

    def __init__(self, ros: Ros, clock: SetClock, header: StreamHeader = HEADER) -> None:
        self.clocks = Clocks(ros.node)
        self.topic = NAME
        self._clock = clock
        self.counters = NodeCounters(refusals=Refusals(clock=clock))
        refusals = self.counters.refusals
        raw = RecordedPublisher(Float32MultiArray, NAME.name, readers=2)
        chunk = RecordedPublisher(Float32MultiArray, f"{NAME.name}_chunk")
        kind = MessageType.FLOAT32_MULTI_ARRAY
        outputs = Outputs(
            raw=NumberWriter(raw, kind, 3, refusals), chunk=ChunkWriter(chunk, kind, 3)
        )
        self.bridge = Bridge(header, outputs, SETTINGS, self.counters, self.clocks)
        self._status = StreamStatus(begun_s=clock.now_s, heard_s=clock.now_s)

    def receive(self, *ages: float) -> Stream:
        """Receive samples of so many seconds ago, each by itself."""
        for age in ages:
            stamp = pylsl.local_clock() - age - (self.clocks.correction or 0.0)
            self.bridge.receive(Block(np.zeros((1, 3), np.float32), np.array([stamp])))
        return self

    def pass_time(self, seconds: float) -> Stream:
        self._clock.now_s += seconds
        return self

    def look(self, spread: float = 0.0) -> DiagnosticStatus:
        facts = stream_facts(
            self.topic,
            self.bridge,
            self._status,
            self.clocks.correction,
            spread,
            pylsl.local_clock(),
        )
        return stream_status(facts)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SetClock:
    clock = SetClock()
    monkeypatch.setattr(diagnostics, "monotonic", clock)
    monkeypatch.setattr(stream_status_module, "monotonic", clock)
    return clock


@pytest.fixture
def stream(ros: Ros, clock: SetClock) -> Stream:
    return Stream(ros, clock)


@pytest.fixture
def irregular(ros: Ros, clock: SetClock) -> Stream:
    """A stream of which no rate can be expected."""
    return Stream(ros, clock, replace(HEADER, rate=0.0, chunk=""))


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {entry.key: entry.value for entry in status.values}


@pytest.mark.seam
def test_a_streaming_stream_is_ok(stream: Stream) -> None:
    stream.clocks.correction = 12.5
    status = stream.receive(0.5).look(spread=0.25)
    assert (status.level, status.message) == (DiagnosticStatus.OK, "streaming")
    assert status.name == "lsl_to_ros: /p01/biosensors/zephyr_left/acc"
    assert status.hardware_id == "U1"
    shown = values(status)
    assert (shown["sensor"], shown["participant"], shown["label"]) == ("zephyr", "p01", "left")
    assert shown["topic"] == "/p01/biosensors/zephyr_left/acc"
    assert shown["chunk_topic"] == "/p01/biosensors/zephyr_left/acc_chunk"
    assert shown["unit_of_measurement"] == "g"
    assert shown["rate_nominal"] == "100.00"
    assert (shown["received"], shown["subscribers"]) == ("1", "3")
    assert (shown["clock_offset_s"], shown["clock_offset_spread_s"]) == ("12.500000", "0.250000")
    for age in ("age_s", "latency_mean_s", "latency_max_s"):
        # The sample was half a second old, and the test takes some time itself.
        assert 0.5 <= float(shown[age]) < 30.0


def test_latencies_are_those_since_the_report_before(stream: Stream) -> None:
    shown = values(stream.receive(4.0, 2.0).look())
    assert 4.0 <= float(shown["latency_max_s"]) < 30.0
    assert 3.0 <= float(shown["latency_mean_s"]) < float(shown["latency_max_s"])
    shown = values(stream.look())
    assert (shown["latency_mean_s"], shown["latency_max_s"]) == ("", "")


def test_what_is_not_known_is_empty(stream: Stream) -> None:
    stream.clocks.correction = None
    shown = values(stream.look())
    for key in ("age_s", "latency_mean_s", "clock_offset_s", "clock_offset_spread_s"):
        assert shown[key] == ""


def test_a_regular_stream_without_samples_is_stale(stream: Stream) -> None:
    assert stream.look().level == DiagnosticStatus.STALE
    assert stream.receive(0.0).look().level == DiagnosticStatus.OK
    assert stream.pass_time(STALE_AFTER_S).look().level == DiagnosticStatus.OK
    assert stream.pass_time(0.1).look().level == DiagnosticStatus.STALE
    assert stream.receive(0.0).look().level == DiagnosticStatus.OK


def test_the_rate_of_a_stream_that_has_fallen_silent_is_not_of_now(stream: Stream) -> None:
    for _ in range(3):
        stream.look()
        stream.pass_time(0.01).receive(0.0)
    assert float(values(stream.look())["rate_measured"]) > 0.0
    status = stream.pass_time(STALE_AFTER_S + 0.1).look()
    assert status.level == DiagnosticStatus.STALE
    assert values(status)["rate_measured"] == "0.00"


def test_a_stream_that_is_slow_is_not_stale_between_its_samples(ros: Ros, clock: SetClock) -> None:
    slow = Stream(ros, clock, replace(HEADER, rate=0.15))
    for age in (20.0, 20.0 * 2 / 3, 20.0 / 3, 0.0):
        slow.receive(age)
        for _ in range(6):
            status = slow.pass_time(1.0).look()
            assert status.level == DiagnosticStatus.OK, status.message
    assert float(values(slow.look())["rate_measured"]) == pytest.approx(0.15, abs=0.01)
    assert slow.pass_time(21.0).look().level == DiagnosticStatus.STALE


@pytest.mark.parametrize(("age", "level"), [(20.0, b"\x00"), (-1e9, b"\x01")])
def test_samples_are_no_silence_whatever_their_stamps(
    stream: Stream, age: float, level: bytes
) -> None:
    for _ in range(7):
        assert stream.pass_time(1.0).receive(age).look().level == level
    assert stream.pass_time(STALE_AFTER_S + 0.1).look().level == DiagnosticStatus.STALE


def test_an_irregular_stream_may_be_silent(irregular: Stream) -> None:
    status = irregular.look()
    assert (status.level, status.message) == (DiagnosticStatus.OK, "no sample yet")
    status = irregular.receive(6.0).look()
    assert (status.level, status.message) == (DiagnosticStatus.OK, "streaming")


@pytest.mark.seam
def test_a_shared_name_is_an_error(stream: Stream) -> None:
    stream.receive(0.0)
    stream.topic = TopicName("biosensors/zephyr_U1", "acc", conflict=True)
    assert stream.look().level == DiagnosticStatus.ERROR
    assert "label" in stream.look().message
    stream.topic = TopicName("biosensors/zephyr", "acc", duplicate=True)
    assert stream.look().level == DiagnosticStatus.ERROR


def test_agents_of_many_computers_may_share_a_name(ros: Ros, clock: SetClock) -> None:
    agent = replace(HEADER, identity=DeviceIdentity("gateway", "lab-pc-1"))
    stream = Stream(ros, clock, agent).receive(0.0)
    stream.topic = TopicName("biosensors/gateway_lab_x2Dpc_x2D1", "counters", conflict=True)
    assert stream.look().level == DiagnosticStatus.OK


def test_samples_that_do_not_fit_are_a_warning_for_a_while(irregular: Stream) -> None:
    assert irregular.receive(0.0).look().level == DiagnosticStatus.OK
    irregular.counters.refusals.refuse(Refusal.UNFIT, 3, why="it is too large")
    status = irregular.pass_time(1.0).receive(0.0).look()
    assert (status.level, values(status)["unfit"]) == (DiagnosticStatus.WARN, "3")
    irregular.pass_time(RATE_WINDOW_S - 1.0)
    assert irregular.receive(0.0).look().level == DiagnosticStatus.WARN
    status = irregular.pass_time(1.0).receive(0.0).look()
    assert (status.level, values(status)["unfit"]) == (DiagnosticStatus.OK, "3")


def test_lost_samples_are_a_warning_for_a_while(irregular: Stream) -> None:
    irregular.counters.comparison.reported(0, 4, 0.0)
    assert irregular.receive(0.0).look().level == DiagnosticStatus.OK
    irregular.counters.comparison.reported(0, 9, 0.0)
    status = irregular.pass_time(1.0).receive(0.0).look()
    assert (status.level, values(status)["lost"]) == (DiagnosticStatus.WARN, "9")
    assert status.message == "5 samples lost in the last 10 s"
    irregular.pass_time(RATE_WINDOW_S - 1.0)
    assert irregular.receive(0.0).look().level == DiagnosticStatus.WARN
    assert irregular.pass_time(1.0).receive(0.0).look().level == DiagnosticStatus.OK


@pytest.mark.seam
def test_what_is_lost_is_counted_estimated_or_unknown_but_never_made_up(
    ros: Ros, clock: SetClock
) -> None:
    ours = Stream(ros, clock)
    assert values(ours.look())["lost"] == "unknown"
    ours.counters.comparison.reported(0, 4, 0.0)
    assert values(ours.look())["lost"] == "4"
    marker = replace(HEADER, rate=0.0, foreign=True)
    assert values(Stream(ros, clock, marker).look())["lost"] == "unknown"
    foreign = Stream(ros, clock, replace(HEADER, foreign=True))
    stamps = np.array([10.0, 10.5])
    foreign.bridge.receive(Block(np.zeros((2, 3), np.float32), stamps))
    assert values(foreign.look())["lost"] == "about 49"


def test_a_clock_that_cannot_be_asked_is_a_warning_after_some_patience(irregular: Stream) -> None:
    irregular.clocks.correction = None
    assert irregular.receive(0.0).pass_time(10.0).look().level == DiagnosticStatus.OK
    status = irregular.receive(0.0).pass_time(0.5).look()
    assert status.level == DiagnosticStatus.WARN
    assert "UDP" in status.message
    irregular.clocks.correction = 0.0
    assert irregular.receive(0.0).look().level == DiagnosticStatus.OK


@pytest.mark.parametrize("age", [1e9, -1e9, 40.0])
def test_stamps_of_another_clock_are_a_warning(stream: Stream, age: float) -> None:
    status = stream.receive(age).look()
    assert status.level == DiagnosticStatus.WARN
    assert "LSL clock" in status.message


def send_at(stream: Stream, rate: float) -> DiagnosticStatus:
    """Let a stream of that true rate be looked at for 12 s; return the last look."""
    status = stream.look()
    start = pylsl.local_clock() - 12.0
    for second in range(12):
        stamps = start + second + np.arange(round(rate)) / rate
        stream.bridge.receive(Block(np.zeros((len(stamps), 3), np.float32), stamps))
        status = stream.pass_time(1.0).look()
    return status


@pytest.mark.parametrize(
    ("rate", "is_off"), [(100, False), (95, False), (106, False), (85, True), (120, True)]
)
def test_a_rate_that_is_far_off_is_a_warning(stream: Stream, rate: float, is_off: bool) -> None:
    status = send_at(stream, rate)
    assert values(status)["rate_measured"] == f"{rate:.2f}"
    assert (status.level == DiagnosticStatus.WARN) is is_off
    assert (status.message == f"{rate:.2f} Hz instead of 100.00 Hz") is is_off


@pytest.fixture
def counters(node: RunningNode, ros: Ros) -> Outlet:
    assert node.is_running
    ros.until(lambda: COUNTERS not in ros.present(), "the end of the counters before")
    identity = DeviceIdentity("gateway", "lab-pc")
    return Outlet(declaration("gateway").stream("counters"), identity, DeviceInfo())


def test_the_agents_counters_are_published_and_compared(ros: Ros, counters: Outlet) -> None:
    topic = "/counted/biosensors/polar_h10/hr"
    identity = DeviceIdentity("polar_h10", "U1", participant="counted")
    outlet = Outlet(declaration("polar_h10").stream("hr"), identity, DeviceInfo())
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

    def is_away() -> bool:
        status = ros.status(topic)
        said = "its sensor is not connected (connecting)"
        return (
            status is not None and status.level == DiagnosticStatus.WARN and said in status.message
        )

    # What comes only now and then is not "streaming" while its sensor is away.
    away = {outlet.source_id: "connecting"}
    told = counters_text({outlet.source_id: outlet.counters}, away=away)
    counters.push_text(told, pylsl.local_clock())
    ros.until(is_away, "that its sensor is away")
    counters.push_text(counters_text({outlet.source_id: outlet.counters}), pylsl.local_clock())
    ros.until(lambda: not is_away(), "that its sensor is back")
    # Nor is it well where its agent leaves something out.
    refused = {outlet.source_id: ["2 samples were not sent: hr was 500"]}
    told = counters_text({outlet.source_id: outlet.counters}, refused=refused)
    counters.push_text(told, pylsl.local_clock())

    def is_told() -> bool:
        status = ros.status(topic)
        said = "2 samples were not sent: hr was 500"
        return (
            status is not None and status.level == DiagnosticStatus.WARN and said in status.message
        )

    ros.until(is_told, "what its agent leaves out")

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


# One status a device: what its own streams tell of battery, contact and signal.
class Lab:
    """Streams whose newest sample a test chooses."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._streams: list[StreamOfDevice] = []

    def tell(self, device: str, header: StreamHeader, *sample: float) -> Lab:
        """Add a stream of a device; without a sample if none is given."""
        counters = NodeCounters(refusals=Refusals(pytest.fail))
        clocks = Clocks(self._ros.node)
        bridge = Bridge(header, Outputs(), SETTINGS, counters, clocks)
        if sample:
            bridge.receive(Block(np.array([sample], np.float32), np.array([100.0])))
        self._streams.append(StreamOfDevice(device, bridge, DiagnosticStatus()))
        return self

    def judged(self, level: bytes, message: str) -> Lab:
        """Give the entry of the stream that was told last a level and a message."""
        entry = DiagnosticStatus(level=level, message=message)
        self._streams[-1] = self._streams[-1]._replace(status=entry)
        return self

    def clock(self, **state: float) -> None:
        """Have the agent tell the clock of the device whose stream was told last."""
        self._streams[-1].bridge.counters.clock = state

    def away(self, state: str) -> None:
        """Have the agent tell that the device whose stream was told last does not send."""
        self._streams[-1].bridge.counters.said = AgentSays(away=state)

    def refused(self, *sentences: str) -> None:
        """Have the agent tell of the device whose stream was told last what it leaves out."""
        text = counters_text({"a-b-c": Counters()}, of_devices={"a-b-c": sentences})
        self._streams[-1].bridge.counters.said = said_of_streams(text)["a-b-c"]

    def statuses(self) -> dict[str, DiagnosticStatus]:
        statuses = list(device_statuses(self._streams))
        names = [status.name.removeprefix("lsl_to_ros: device ") for status in statuses]
        assert len(set(names)) == len(names)
        return dict(zip(names, statuses, strict=True))

    def status(self) -> DiagnosticStatus:
        (status,) = self.statuses().values()
        return status


@pytest.fixture
def lab(ros: Ros) -> Lab:
    return Lab(ros)


BATTERY = header_of("zephyr", "bat")


def test_its_clock_is_what_the_agent_tells_of_it(lab: Lab) -> None:
    lab.tell("zephyr", header_of("zephyr", "ecg"), 512).clock(
        offset_s=-1795230819.108032, drift_ppm=3.18, residual_rms_s=0.000271, reanchors=1
    )
    status = lab.status()
    assert status.level == DiagnosticStatus.OK
    assert values(status) == {
        "clock/offset_s": "-1795230819.108032",
        "clock/drift_ppm": "3.18",
        "clock/residual_rms_s": "0.000271",
        "clock/reanchors": "1",
    }


@pytest.mark.seam
def test_a_device_is_described_by_what_its_streams_tell(lab: Lab) -> None:
    lab.tell("zephyr", BATTERY, 55.5)
    lab.tell("zephyr", header_of("zephyr", "rssi"), -61)
    lab.tell("zephyr", header_of("zephyr", "quality"), 1, 90, 0, 0, 0, 3)
    lab.tell("zephyr", header_of("zephyr", "ecg"), 512)
    lab.tell("zephyr", header_of("zephyr", "hr"), 60)
    status = lab.status()
    assert status.level == DiagnosticStatus.OK
    assert status.hardware_id == "U1"
    assert values(status) == {
        "bat/level": "55.5",
        "rssi/signal": "-61",
        "quality/worn": "1",
        "quality/hr_confidence": "90",
        "quality/hr_unreliable": "0",
        "quality/br_unreliable": "0",
        "quality/hrv_unreliable": "0",
        "quality/link_quality": "3",
    }


@pytest.mark.parametrize(
    ("state", "said"),
    [("paused", "its sensor is paused"), ("backoff", "is not connected (backoff)")],
)
def test_what_a_device_sent_before_it_was_away_is_not_of_now(
    lab: Lab, state: str, said: str
) -> None:
    lab.tell("ble_heart_rate", header_of("ble_heart_rate", "bat"), 60)
    lab.tell("ble_heart_rate", header_of("ble_heart_rate", "quality"), 1)
    lab.away(state)
    status = lab.status()
    assert status.level == DiagnosticStatus.WARN
    assert said in status.message
    assert values(status) == {}


def test_what_an_agent_leaves_out_of_a_device_is_told_beside_its_battery(lab: Lab) -> None:
    lab.tell("zephyr", BATTERY, 5)
    lab.refused("41 bytes were garbled")
    status = lab.status()
    assert status.level == DiagnosticStatus.WARN
    assert status.message == "battery at 5 %; 41 bytes were garbled"
    lab.refused()
    assert lab.status().message == "battery at 5 %"


FLAT = "ECG has not changed for 10 s or longer"
TWICE = "another sender has the same source_id"


def test_a_device_is_not_better_than_its_streams(lab: Lab) -> None:
    lab.tell("zephyr", BATTERY, 55)
    lab.tell("zephyr", header_of("zephyr", "ecg"), 512).judged(DiagnosticStatus.WARN, FLAT)
    lab.tell("zephyr", header_of("zephyr", "breathing"), 512).judged(DiagnosticStatus.WARN, FLAT)
    status = lab.status()
    assert (status.level, status.message) == (
        DiagnosticStatus.WARN,
        f"ecg, breathing: {FLAT}",
    )
    lab.tell("zephyr", header_of("zephyr", "acc"), 1, 2, 3).judged(DiagnosticStatus.ERROR, TWICE)
    status = lab.status()
    assert (status.level, status.message) == (
        DiagnosticStatus.ERROR,
        f"acc: {TWICE}; ecg, breathing: {FLAT}",
    )


def test_a_device_is_stale_only_if_all_its_regular_streams_are(lab: Lab) -> None:
    lab.tell("zephyr", BATTERY, 55)
    lab.tell("zephyr", header_of("zephyr", "ecg")).judged(DiagnosticStatus.STALE, "no samples")
    assert lab.status().level == DiagnosticStatus.STALE
    lab.tell("zephyr", header_of("zephyr", "acc"), 1, 2, 3)
    status = lab.status()
    assert (status.level, status.message) == (DiagnosticStatus.WARN, "ecg: no samples")


def test_a_device_that_is_away_says_so_once_but_also_that_its_source_id_is_doubled(
    lab: Lab,
) -> None:
    lab.tell("zephyr", header_of("zephyr", "ecg")).judged(DiagnosticStatus.ERROR, TWICE)
    lab.tell("zephyr", BATTERY, 55).judged(DiagnosticStatus.WARN, "its sensor is paused")
    lab.away("paused")
    status = lab.status()
    assert status.level == DiagnosticStatus.ERROR
    assert status.message.endswith(f"; ecg: {TWICE}")
    assert status.message.count("is paused") == 1


@pytest.mark.seam
def test_each_device_has_a_status_of_its_own(lab: Lab) -> None:
    lab.tell("p01/zephyr_left", BATTERY, 5)
    lab.tell("p01/zephyr_right", BATTERY, 50)
    lab.tell("polar_h10", header_of("polar_h10", "bat"), 60)
    statuses = lab.statuses()
    levels = {name: status.level for name, status in statuses.items()}
    assert levels == {
        "p01/zephyr_left": DiagnosticStatus.WARN,
        "p01/zephyr_right": DiagnosticStatus.OK,
        "polar_h10": DiagnosticStatus.OK,
    }


@pytest.mark.parametrize(
    ("percent", "is_low"),
    [(0, True), (9.5, True), (10, True), (10.5, False), (100, False), (math.nan, False)],
)
def test_a_low_battery_is_a_warning(lab: Lab, percent: float, is_low: bool) -> None:
    assert LOW_BATTERY_PERCENT == 10
    status = lab.tell("zephyr", BATTERY, percent).status()
    assert (status.level == DiagnosticStatus.WARN) is is_low
    assert ("battery" in status.message) is is_low
    assert (f"{percent:g} %" in status.message) is is_low


@pytest.mark.parametrize(("percent", "is_low"), [(7, True), (70, False), (math.nan, False)])
def test_the_headsets_battery_is_in_its_status(lab: Lab, percent: float, is_low: bool) -> None:
    device = header_of("emotiv_insight", "dev")
    # Its grades of battery and contact are small numbers, but no percentages.
    sample = [1.0] * (len(device.labels) - 1) + [percent]
    status = lab.tell("emotiv_insight", device, *sample).status()
    assert (status.level == DiagnosticStatus.WARN) is is_low
    assert values(status)["dev/BatteryPercent"] == f"{percent:g}"


CONTACTS = [
    ("polar_h10", "contact"),
    ("ble_heart_rate", "contact"),
    ("empatica_e4", "worn"),
    ("zephyr", "worn"),
    ("shimmer3_gsr", "electrodes"),
]


@pytest.mark.parametrize(("sensor_name", "label"), CONTACTS)
@pytest.mark.parametrize(("value", "is_off"), [(0, True), (1, False), (math.nan, False)])
def test_a_sensor_that_is_not_worn_is_a_warning(
    lab: Lab, sensor_name: str, label: str, value: float, is_off: bool
) -> None:
    header = header_of(sensor_name, "quality")
    sample = [1.0] * len(header.labels)
    sample[header.labels.index(label)] = value
    status = lab.tell(sensor_name, header, *sample).status()
    assert (status.level, status.message) == (
        (DiagnosticStatus.WARN, "not worn")
        if is_off
        else (DiagnosticStatus.OK, "as its streams report")
    )


@pytest.mark.parametrize("sensor_name", declaration_names())
def test_no_other_channel_of_a_declared_stream_is_a_warning_at_zero(
    lab: Lab, sensor_name: str
) -> None:
    contacts = {"level", "BatteryPercent", *(label for _, label in CONTACTS)}
    for stream in declaration(sensor_name).streams:
        if stream.message_type.is_text:
            continue
        header = header_of(sensor_name, stream.data_name, rate=0.0)
        sample = [float(label in contacts) * 100 for label in header.labels]
        lab.tell(sensor_name, header, *sample)
    for status in lab.statuses().values():
        assert status.level == DiagnosticStatus.OK


def test_a_sensor_that_this_version_has_never_heard_of_is_judged_by_its_roles(lab: Lab) -> None:
    told = (None, ChannelRole.CONTACT, ChannelRole.STATE_OF_CHARGE, ChannelRole.SIGNAL_STRENGTH)
    patch = replace(
        header_of("zephyr", "quality"),
        content_type="Patch",
        data_name="patch",
        labels=("pressure", "on", "full", "received"),
        units=("mmHg", "boolean", "percent", "dBm"),
        roles=told,
    )
    status = lab.tell("well", patch, 0, 1, 80, 0).tell("off", patch, 1, 0, 80, 0).statuses()
    assert values(status["well"]) == {"patch/on": "1", "patch/full": "80", "patch/received": "0"}
    assert (status["well"].level, status["off"].message) == (DiagnosticStatus.OK, "not worn")
    assert "battery at 3 %" in lab.tell("low", patch, 1, 1, 3, 0).statuses()["low"].message


def test_a_name_alone_means_nothing(lab: Lab) -> None:
    quality = header_of("zephyr", "quality")
    nothing = replace(quality, roles=(None,) * len(quality.roles))
    assert lab.tell("zephyr", nothing, 0, 0, 0, 0, 0, 0).status().level == DiagnosticStatus.OK


def test_a_stream_that_has_not_said_anything_yet_tells_nothing(lab: Lab) -> None:
    status = lab.tell("zephyr", BATTERY).status()
    assert (status.level, values(status)) == (DiagnosticStatus.OK, {})


def test_streams_of_other_programs_are_no_devices(lab: Lab) -> None:
    lab.tell("cap", replace(BATTERY, foreign=True), 5)
    assert lab.statuses() == {}


def test_text_is_no_state(lab: Lab) -> None:
    text = replace(
        BATTERY,
        content_type=ContentType.STATUS.value,
        format=ChannelFormat.STRING,
        message_type=MessageType.STRING,
    )
    status = lab.tell("zephyr", text).status()
    assert (status.level, values(status)) == (DiagnosticStatus.OK, {})


def test_entries_have_the_name_of_their_node(ros: Ros) -> None:
    entries = [
        DiagnosticStatus(name="lsl_to_ros: node"),
        DiagnosticStatus(name="lsl_to_ros: /a: b"),
    ]
    diagnostics.named_by(ros.node, entries)
    own = ros.node.get_fully_qualified_name().lstrip("/")
    assert own != "lsl_to_ros"
    assert [each.name for each in entries] == [f"{own}: node", f"{own}: /a: b"]
