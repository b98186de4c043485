"""One status a device: what its own streams tell of battery, contact and signal."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.lsl.inlet import Block
from biosensor_common.quantities import ChannelFormat, ChannelRole, ContentType, MessageType
from biosensor_common.refusal import Refusals
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.devices.registry import declaration, declaration_names
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.reports.reporter import LOW_BATTERY_PERCENT, device_statuses
from lsl_to_ros.statistics.losses import NodeCounters
from lsl_to_ros.topics.bridge import Bridge, Outputs
from tests.rigs.recorded_topics import Clocks, header_of

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = pytest.mark.nightly

SETTINGS = StreamSettings(raw=True, chunk=True, chunk_length=8)
Named = tuple[str, Bridge]


class Lab:
    """Streams whose newest sample a test chooses."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._bridges: list[Named] = []

    def tell(self, device: str, header: StreamHeader, *sample: float) -> Lab:
        """Add a stream of a device; without a sample if none is given."""
        counters = NodeCounters(refusals=Refusals(pytest.fail))
        clocks = Clocks(self._ros.node)
        bridge = Bridge(header, Outputs(), SETTINGS, counters, clocks)
        if sample:
            bridge.receive(Block(np.array([sample], np.float32), np.array([100.0])))
        self._bridges.append((device, bridge))
        return self

    def clock(self, **state: float) -> None:
        """Have the agent tell the clock of the device whose stream was told last."""
        self._bridges[-1][1].counters.clock = state

    def statuses(self) -> dict[str, DiagnosticStatus]:
        statuses = list(device_statuses(self._bridges))
        names = [status.name.removeprefix("lsl_to_ros: device ") for status in statuses]
        assert len(set(names)) == len(names)
        return dict(zip(names, statuses, strict=True))

    def status(self) -> DiagnosticStatus:
        (status,) = self.statuses().values()
        return status


@pytest.fixture
def lab(ros: Ros) -> Lab:
    return Lab(ros)


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {entry.key: entry.value for entry in status.values}


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
        else (DiagnosticStatus.OK, "as its streams tell")
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
