"""Topics of ``sensor_msgs`` beside our own, as a subscriber gets them."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from sensor_msgs.msg import BatteryState, Imu, MagneticField, Temperature

from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

HEADSET = DeviceIdentity("emotiv_insight", "INSIGHT-1")
WRISTBAND = DeviceIdentity("empatica_e4", "A01234", participant="p01", label="left")
WRIST = "/p01/biosensors/empatica_e4_left"
STAMP_TOLERANCE_S = 1e-3
GRAVITY = 9.80665
NO_ANGLE = [-1.0, *[0.0] * 8]
UNKNOWN = [0.0] * 9


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


def test_what_other_programs_call_a_battery_has_no_standard_message(ros: Ros) -> None:
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("gadget", "Battery", 1, 0.0, "float32", "gadget"))
    ros.attached("/biosensors/gadget/Battery")
    ros.until(lambda: "/biosensors/gadget/Battery" in ros.topics(), "its topic")
    assert not [topic for topic in ros.topics() if topic.startswith("/biosensors/gadget/Battery_")]
    del outlet
