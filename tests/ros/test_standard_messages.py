"""Topics of ``sensor_msgs``: who gets them, and that they hold what the messages say."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
import pytest
from sensor_msgs.msg import BatteryState, Imu, MagneticField, Temperature
from std_msgs.msg import Header, String

from biosensor_common.quantities import (
    ACCELERATION,
    ORIENTATION,
    ChannelFormat,
    ContentType,
    MessageType,
    Unit,
)
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.live_table import Row, fitted, render, widths
from lsl_to_ros.topics.outputs import STANDARD_CLASSES
from lsl_to_ros.topics.writers import Run, StandardMessageWriter
from tests.rigs.recorded_topics import Clocks, RecordedPublisher, header_of, message_time

if TYPE_CHECKING:
    from tests.ros.conftest import Ros


STREAMS = [
    (name, stream.data_name) for name in declaration_names() for stream in declaration(name).streams
]
# As the design has it for the first sensors: the headset's motion, every battery, every skin
# temperature.
EXPECTED: dict[tuple[str, str], dict[str, type[Any]]] = {
    ("emotiv_insight", "mot"): {"mot_imu": Imu, "mot_mag": MagneticField},
    ("emotiv_insight", "dev"): {"bat_state": BatteryState},
    ("empatica_e4", "bat"): {"bat_state": BatteryState},
    ("empatica_e4", "st"): {"st_temperature": Temperature},
    ("shimmer3_gsr", "bat"): {"bat_state": BatteryState},
    ("polar_h10", "bat"): {"bat_state": BatteryState},
    ("vernier_respiration_belt", "bat"): {"bat_state": BatteryState},
    ("zephyr", "bat"): {"bat_state": BatteryState},
    ("zephyr", "st"): {"st_temperature": Temperature},
    ("ble_heart_rate", "bat"): {"bat_state": BatteryState},
}
FIRST_SENSORS = {sensor_name for sensor_name, _ in EXPECTED}
# Of all others, by what a stream is called and its first channel's unit.
EXPECTED_OF_OTHERS: dict[tuple[str, Unit], dict[str, type[Any]]] = {
    ("bat", Unit.PERCENT): {"bat_state": BatteryState},
    ("st", Unit.CELSIUS): {"st_temperature": Temperature},
    ("temp", Unit.CELSIUS): {"temp_temperature": Temperature},
    ("mag", Unit.MICROTESLA): {"mag_mag": MagneticField},
}
MOTION = header_of("emotiv_insight", "mot")
DEVICE = header_of("emotiv_insight", "dev")
BATTERY = header_of("zephyr", "bat", participant="p01", label="left")
SKIN = header_of("zephyr", "st")

DTYPES = {
    ChannelFormat.FLOAT32: np.float32,
    ChannelFormat.DOUBLE64: np.float64,
    ChannelFormat.INT16: np.int16,
}
G = 9.80665
MISSING = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
UNKNOWN = [0.0] * 9
FRAME = "p01/zephyr_left"


def classes_of(header: StreamHeader) -> dict[str, type[Any]]:
    return {
        each.data: STANDARD_CLASSES[each.type_name] for each in standard_messages(header, FRAME)
    }


class Wire:
    """Samples of a stream on their way to a standard message's subscribers."""

    def __init__(self, ros: Ros, header: StreamHeader, kind: type[Any]) -> None:
        (messages,) = [
            each
            for each in standard_messages(header, FRAME)
            if STANDARD_CLASSES[each.type_name] is kind
        ]
        self.clocks = Clocks(ros.node, 12.5)
        self.publisher = RecordedPublisher(kind)
        self._header = header
        self._writer = StandardMessageWriter(self.publisher, messages, self.clocks)

    def send(self, *samples: list[float], start: float = 100.0) -> list[Any]:
        """Write a run; return the messages so far."""
        stamps = np.array([start + number * 0.25 for number in range(len(samples))])
        self._writer.write(Run(np.array(samples, DTYPES[self._header.format]), stamps, 0))
        return self.publisher.messages


@pytest.mark.parametrize(("sensor_name", "data_name"), STREAMS)
def test_which_standard_messages_a_declared_stream_has(sensor_name: str, data_name: str) -> None:
    header = header_of(sensor_name, data_name)
    found = classes_of(header)
    if sensor_name in FIRST_SENSORS:
        expected = EXPECTED.get((sensor_name, data_name), {})
    else:
        expected = EXPECTED_OF_OTHERS.get((data_name, Unit(header.units[0])), {})
    assert found == expected


def test_every_expected_message_is_of_a_declared_stream() -> None:
    assert EXPECTED.keys() <= set(STREAMS)


@pytest.mark.parametrize(
    "header",
    [
        replace(SKIN, units=(Unit.MILLIVOLTS,)),
        replace(SKIN, content_type=ContentType.ACTIVITY.value),
        # What is called so, but does not say that it is.
        replace(BATTERY, roles=(None,)),
        replace(DEVICE, roles=(None,) * 9),
        replace(MOTION, roles=(None,) * 10),
        # Components are missing.
        replace(MOTION, roles=(None, *MOTION.roles[1:-1], None)),
    ],
    ids=lambda header: f"{header.content_type}-{header.units[0]}-{header.roles[-2:]}",
)
def test_what_only_looks_alike_has_no_standard_message(header: StreamHeader) -> None:
    assert classes_of(header) == {}


def test_a_sensor_that_this_version_has_never_heard_of_has_them_too() -> None:
    core = replace(SKIN, identity=replace(SKIN.identity, sensor="new_patch"), data_name="core")
    assert set(classes_of(core)) == {"core_temperature"}
    roles = (*ACCELERATION, *ORIENTATION[::-1])
    units = tuple(role.unit for role in roles)
    motion = replace(MOTION, data_name="head", labels=tuple("abcdefg"), units=units, roles=roles)
    assert set(classes_of(motion)) == {"head_imu"}
    charge = replace(BATTERY, data_name="accumulator", labels=("full",), content_type="Power")
    assert set(classes_of(charge)) == {"accumulator_state"}


@pytest.mark.nightly
def test_orientation_and_acceleration_are_in_si_units(ros: Ros) -> None:
    sample = [0.5, 0.25, -0.5, 0.125, 1.0, -2.0, 0.5, 30.0, -40.0, 50.0]
    (message,) = Wire(ros, MOTION, Imu).send(sample)
    assert quaternion(message) == (0.25, -0.5, 0.125, 0.5)
    acceleration = message.linear_acceleration
    assert (acceleration.x, acceleration.y, acceleration.z) == (G, -2 * G, 0.5 * G)
    assert list(message.orientation_covariance) == UNKNOWN
    assert list(message.linear_acceleration_covariance) == UNKNOWN
    assert list(message.angular_velocity_covariance) == MISSING


def quaternion(message: Any) -> tuple[float, float, float, float]:
    at = message.orientation
    return at.x, at.y, at.z, at.w


@pytest.mark.nightly
@pytest.mark.parametrize("missing", [range(4), [0], [1], [2], [3]])
def test_an_orientation_that_was_not_measured_is_said_to_be_missing(ros: Ros, missing: Any) -> None:
    sample = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 30.0, -40.0, 50.0]
    for place in missing:
        sample[place] = math.nan
    (message,) = Wire(ros, MOTION, Imu).send(sample)
    assert list(message.orientation_covariance) == MISSING
    # A quaternion that rotates by nothing, for who does not look at the covariance.
    assert quaternion(message) == (0.0, 0.0, 0.0, 1.0)
    assert message.linear_acceleration.z == G


@pytest.mark.nightly
def test_the_channels_of_motion_are_found_by_their_roles(ros: Ros) -> None:
    turned = replace(MOTION, roles=MOTION.roles[::-1], units=MOTION.units[::-1])
    sample = [float(number) for number in range(10)]
    (imu,) = Wire(ros, turned, Imu).send(sample[::-1])
    assert quaternion(imu) == (1.0, 2.0, 3.0, 0.0)
    assert imu.linear_acceleration.x == 4 * G
    (field,) = Wire(ros, turned, MagneticField).send(sample[::-1])
    assert field.magnetic_field.z == pytest.approx(9e-6, rel=1e-12)


@pytest.mark.nightly
def test_the_magnetic_field_is_in_tesla(ros: Ros) -> None:
    sample = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 30.0, -40.0, math.nan]
    (message,) = Wire(ros, MOTION, MagneticField).send(sample)
    field = message.magnetic_field
    assert (field.x, field.y) == pytest.approx((30e-6, -40e-6), rel=1e-12)
    # The message's own word for a component that is not measured.
    assert math.isnan(field.z)
    assert list(message.magnetic_field_covariance) == UNKNOWN


def check_battery(message: Any, charge: float) -> None:
    """The charge, and nothing that nobody measured."""
    assert message.percentage == pytest.approx(charge, rel=1e-6)
    for unmeasured in (
        message.voltage,
        message.temperature,
        message.current,
        message.charge,
        message.capacity,
        message.design_capacity,
    ):
        assert math.isnan(unmeasured)
    assert message.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
    assert message.power_supply_health == BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN
    assert message.power_supply_technology == BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN
    assert message.present is True
    assert list(message.cell_voltage) == list(message.cell_temperature) == []


@pytest.mark.nightly
@pytest.mark.parametrize("percent", [0.0, 1.0, 55.0, 99.5, 100.0])
def test_a_battery_is_a_fraction(ros: Ros, percent: float) -> None:
    (message,) = Wire(ros, BATTERY, BatteryState).send([percent])
    check_battery(message, percent / 100)
    assert (message.location, message.serial_number) == ("left", "U1")


@pytest.mark.nightly
def test_the_headsets_battery_is_in_its_status(ros: Ros) -> None:
    status = dict.fromkeys(DEVICE.labels, 4.0) | {"Battery": 3.0, "BatteryPercent": 87.0}
    (message,) = Wire(ros, DEVICE, BatteryState).send(list(status.values()))
    check_battery(message, 0.87)
    status["BatteryPercent"] = math.nan
    message = Wire(ros, DEVICE, BatteryState).send(list(status.values()))[0]
    assert math.isnan(message.percentage)


@pytest.mark.nightly
def test_a_temperature_is_in_degrees_celsius(ros: Ros) -> None:
    first, second = Wire(ros, SKIN, Temperature).send([33.5], [math.nan])
    assert (first.temperature, first.variance) == (33.5, 0.0)
    assert math.isnan(second.temperature)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("header", "kind"),
    [(SKIN, Temperature), (BATTERY, BatteryState), (MOTION, Imu), (MOTION, MagneticField)],
)
def test_every_message_says_where_and_when_it_was_measured(
    ros: Ros, header: StreamHeader, kind: type[Any]
) -> None:
    wire = Wire(ros, header, kind)
    sample = [1.0] * len(header.labels)
    messages = wire.send(sample, sample, sample, start=200.0)
    times = [
        message_time(wire.clocks.ros_time.to_ns(200.0 + 12.5 + place * 0.25)) for place in range(3)
    ]
    expected = [Header(stamp=time, frame_id=FRAME) for time in times]
    assert [message.header for message in messages] == expected


@pytest.mark.nightly
@pytest.mark.parametrize("channel_format", [ChannelFormat.INT16, ChannelFormat.DOUBLE64])
@pytest.mark.parametrize(
    ("header", "kind"),
    [(SKIN, Temperature), (BATTERY, BatteryState), (MOTION, Imu), (MOTION, MagneticField)],
)
def test_a_stream_of_another_format_has_the_same_standard_message(
    ros: Ros, channel_format: ChannelFormat, header: StreamHeader, kind: type[Any]
) -> None:
    sample = [float(number) for number in range(len(header.labels))]
    (usual,) = Wire(ros, header, kind).send(sample)
    (message,) = Wire(ros, replace(header, format=channel_format), kind).send(sample)
    message.header = usual.header
    # As text, for NaN is not equal to itself.
    assert repr(message) == repr(usual)


# The table of the demo fits a terminal of 100 columns.

WIDTH = 100
HEADINGS = ("topic", "type", "Hz", "nominal", "last value", "age s", "lost")
EVENT = json.dumps({"type": "device", "what": "connected", "why": "x" * 400})
VECTOR = "-0.123 -0.0456 -9.81e-05 microvolts"


def line(topic: str, value: str) -> tuple[str, ...]:
    return (topic, "Float32MultiArray", "1024.00", "irregular", value, "12.3", "unknown")


def total(lines: list[tuple[str, ...]]) -> int:
    return sum(widths(lines)) + 2 * (len(HEADINGS) - 1)


def table(prefix: str) -> list[tuple[str, ...]]:
    topics = [
        f"/biosensors/{prefix}{name}/{stream.data_name}_chunk"
        for name in declaration_names()
        for stream in declaration(name).streams
    ]
    return [HEADINGS, *(line(topic, VECTOR) for topic in topics), line("/biosensors/e", EVENT)]


def test_names_and_units_stay_whole() -> None:
    lines = list(fitted(table(""), WIDTH))
    assert total(lines) <= WIDTH
    assert "vernier_respiration_belt/force_chunk" in [each[0] for each in lines]
    assert lines[1][4].startswith("-0.12")
    assert all(each[4].endswith(("microvolts", "...")) for each in lines[1:])
    assert lines[0][0] == "topic in /biosensors/"
    assert all(each[2:4] == ("1024.00", "irregular") for each in lines[1:])


def test_a_long_participant_shortens_the_name_last() -> None:
    lines = list(fitted(table("participant_0123_left_upper_arm/"), WIDTH))
    assert total(lines) <= WIDTH
    assert any(each[0].endswith("force_chunk") for each in lines)


def test_a_table_that_fits_is_not_cut() -> None:
    assert fitted(table(""), 200) != table("")
    assert fitted(table(""), 1000) == table("")


def test_the_table_fits_a_terminal_of_80_columns() -> None:
    rows = [
        Row(each[0].removesuffix("_chunk"), MessageType.STRING, 7, last=String(data=EVENT))
        for each in table("")[1:]
    ]
    rows.append(Row("/biosensors/gateway/counters", MessageType.DIAGNOSTIC_ARRAY))
    lines = render(rows, 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].endswith("lost")
    assert all(each.endswith("unknown") for each in lines[1:])


def test_without_a_terminal_the_table_fits_a_log() -> None:
    topics = table("")[1:]
    rows = [
        Row(each[0].removesuffix("_chunk"), MessageType.STRING, 7, last=String(data=EVENT))
        for each in topics
    ]
    rows.append(Row("/biosensors/gateway/counters", MessageType.DIAGNOSTIC_ARRAY))
    lines = render(rows).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith("topic in /biosensors/ ")
    assert all(each.endswith("unknown") for each in lines[1:])


if TYPE_CHECKING:
    from tests.ros.conftest import Ros


HEADSET = DeviceIdentity("emotiv_insight", "INSIGHT-1")
WRISTBAND = DeviceIdentity("empatica_e4", "A01234", participant="p01", label="left")
WRIST = "/p01/biosensors/empatica_e4_left"
STAMP_TOLERANCE_S = 1e-3
GRAVITY = 9.80665
NO_ANGLE = [-1.0, *[0.0] * 8]


def outlet_of(identity: DeviceIdentity, data: str, rate: float = 64.0) -> Outlet:
    stream = declaration(identity.sensor).stream(data)
    if isinstance(stream.rate, FromDevice):
        stream = replace(stream, rate=rate)
    return Outlet(stream, identity, DeviceInfo())


def push(outlet: Outlet, sample: list[float]) -> float:
    """Push a sample that was measured a moment ago; return that moment as system time."""
    unchecked: pylsl.StreamOutlet = vars(outlet)["_outlet"]
    stamp = pylsl.local_clock() - 0.25
    unchecked.push_sample(sample, stamp)
    return stamp + system_offset()


def system_offset() -> float:
    """System time minus LSL time, from the quickest of many readings of both."""
    readings: list[tuple[float, float]] = []
    for _ in range(50):
        before = time.time()
        lsl = pylsl.local_clock()
        after = time.time()
        readings.append((after - before, (before + after) / 2 - lsl))
    return min(readings)[1]


def check_header(message: Any, frame_id: str, measured: float) -> None:
    stamp = message.header.stamp
    assert message.header.frame_id == frame_id
    assert stamp.sec + stamp.nanosec * 1e-9 == pytest.approx(measured, abs=STAMP_TOLERANCE_S)


def vector(message: Any) -> list[float]:
    return [message.x, message.y, message.z]


@pytest.mark.nightly
@pytest.mark.usefixtures("node")
def test_motion_is_an_imu_and_a_magnetic_field(ros: Ros) -> None:
    outlet = outlet_of(HEADSET, "mot")
    base = "/biosensors/emotiv_insight"
    imu = ros.listen(Imu, f"{base}/mot_imu")
    field = ros.listen(MagneticField, f"{base}/mot_mag")
    ros.attached(f"{base}/mot", readers=2)
    quaternion, acceleration, magnet = [0.5, -0.5, 0.5, 0.25], [0.0, -1.0, 0.125], [24.0, -40, 8]
    first = push(outlet, [*quaternion, *acceleration, *magnet])
    # Older firmware tells no orientation.
    second = push(outlet, [*[math.nan] * 4, *acceleration, *magnet])
    ros.until(lambda: len(imu) == len(field) == 2, "two samples of each")
    for message, measured in zip(imu, (first, second), strict=True):
        check_header(message, "emotiv_insight", measured)
        assert vector(message.linear_acceleration) == pytest.approx(
            [GRAVITY * value for value in acceleration]
        )
        assert list(message.linear_acceleration_covariance) == UNKNOWN
        assert list(message.angular_velocity_covariance) == NO_ANGLE
    known, unknown = imu
    assert [known.orientation.w, *vector(known.orientation)] == quaternion
    assert list(known.orientation_covariance) == UNKNOWN
    assert list(unknown.orientation_covariance) == NO_ANGLE
    for message, measured in zip(field, (first, second), strict=True):
        check_header(message, "emotiv_insight", measured)
        assert vector(message.magnetic_field) == pytest.approx([24e-6, -40e-6, 8e-6])
        assert list(message.magnetic_field_covariance) == UNKNOWN


@pytest.mark.nightly
@pytest.mark.usefixtures("node")
def test_a_battery_is_a_battery_state_with_the_fraction(ros: Ros) -> None:
    wrist, headset = outlet_of(WRISTBAND, "bat"), outlet_of(HEADSET, "dev")
    labels = [channel.label for channel in headset.stream.channels]
    of_wrist = ros.listen(BatteryState, f"{WRIST}/bat_state")
    of_headset = ros.listen(BatteryState, "/biosensors/emotiv_insight/bat_state")
    ros.attached(f"{WRIST}/bat", "/biosensors/emotiv_insight/dev", readers=1)
    wrist_time = push(wrist, [42.5])
    headset_time = push(headset, [61.0 if label == "BatteryPercent" else 4.0 for label in labels])
    ros.until(lambda: bool(of_wrist and of_headset), "a state of each")
    check_header(of_wrist[0], "p01/empatica_e4_left", wrist_time)
    check_header(of_headset[0], "emotiv_insight", headset_time)
    for message, percentage in ((of_wrist[0], 0.425), (of_headset[0], 0.61)):
        assert message.percentage == pytest.approx(percentage)
        assert message.present
        unmeasured = (
            message.voltage,
            message.temperature,
            message.current,
            message.charge,
            message.capacity,
            message.design_capacity,
        )
        assert all(math.isnan(value) for value in unmeasured)
        assert message.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
        assert message.power_supply_health == BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN
        assert message.power_supply_technology == BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN
    assert (of_wrist[0].location, of_wrist[0].serial_number) == ("left", "A01234")
    assert (of_headset[0].location, of_headset[0].serial_number) == ("", "INSIGHT-1")


@pytest.mark.nightly
@pytest.mark.usefixtures("node")
def test_skin_temperature_is_a_temperature_also_where_there_is_none(ros: Ros) -> None:
    outlet = outlet_of(WRISTBAND, "st")
    heard = ros.listen(Temperature, f"{WRIST}/st_temperature")
    ros.attached(f"{WRIST}/st", readers=1)
    measured = [push(outlet, [value]) for value in (33.25, math.nan)]
    ros.until(lambda: len(heard) == 2, "two samples")
    for message, moment in zip(heard, measured, strict=True):
        check_header(message, "p01/empatica_e4_left", moment)
        assert message.variance == 0.0
    assert heard[0].temperature == 33.25
    assert math.isnan(heard[1].temperature)


@pytest.mark.nightly
@pytest.mark.usefixtures("node")
def test_what_other_programs_call_a_battery_has_no_standard_message(ros: Ros) -> None:
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("gadget", "Battery", 1, 0.0, "float32", "gadget"))
    ros.attached("/biosensors/gadget/Battery")
    ros.until(lambda: "/biosensors/gadget/Battery" in ros.topics(), "its topic")
    assert not [topic for topic in ros.topics() if topic.startswith("/biosensors/gadget/Battery_")]
    del outlet
