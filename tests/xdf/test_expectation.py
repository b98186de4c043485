"""Which streams are expected, and what is said of those that are not there."""

from __future__ import annotations

import pytest

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.devices.registry import declaration, sensor, sensor_names
from biosensor_gateway.recording.xdf.expectation import by_devices, by_name
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.outlets import Outlet
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes

FILE = x.xdf(
    *x.regular(1, "a", [1000 + k / 10 for k in range(300)], 10.0),
    x.stream_header(2, "empty"),
    x.offsets(2, (1005, 1010)),
    x.footer(2, 0),
)


@pytest.mark.parametrize("name", ["a", "a-id"])
def test_a_stream_is_expected_by_name_or_source_id(name: str) -> None:
    assert check(FILE, *by_name([name])).is_good


def test_a_missing_stream_is_an_error() -> None:
    assert codes(check(FILE, *by_name(["a", "b"])), Level.ERROR) == {("missing", "b")}


def test_a_stream_that_is_asked_for_must_have_samples() -> None:
    assert check(FILE).is_good
    report = check(FILE, *by_name(["empty"]))
    assert codes(report, Level.ERROR) == {("expected-empty", "empty")}


def test_every_stream_of_every_enabled_device_is_expected() -> None:
    devices = [
        DeviceSettings(sensor="zephyr", unit="1", participant="p01", label="left"),
        DeviceSettings(sensor="polar_h10", unit="2", enabled=False),
    ]
    identity = DeviceIdentity("zephyr", "1", "p01", "left")
    names = {f"p01-zephyr__left-1-{each.data_name}" for each in declaration("zephyr").streams}
    expected = by_devices(devices)
    assert {each.name for each in expected} == names
    assert {each.source_id for each in expected} == {
        f"p01@zephyr.left-{each.data_name}" for each in declaration("zephyr").streams
    }
    report = check(FILE, *expected)
    assert codes(report, Level.ERROR) == {("missing", name) for name in names}
    # What is expected is what the agent really names its outlet.
    outlet = Outlet(declaration("zephyr").stream("ecg"), identity, DeviceInfo())
    assert (outlet.name, outlet.source_id) in {(each.name, each.source_id) for each in expected}


def test_a_stream_of_a_sensor_may_be_empty() -> None:
    (expected,) = (
        e
        for e in by_devices([DeviceSettings(sensor="zephyr", unit="1")])
        if e.source_id == "zephyr-1-st"
    )
    header = x.stream_header(2, "empty", source_id="zephyr-1-st")
    content = FILE.replace(x.stream_header(2, "empty"), header)
    assert content != FILE
    assert check(content, expected).is_good


def test_all_sensors_can_be_expected() -> None:
    with simulated_settings(["all"]) as settings:
        expected = {device.sensor: by_devices([device]) for device in settings.devices}
    assert set(expected) == {name for name in sensor_names() if sensor(name).virtual}
    assert all(expected.values())
