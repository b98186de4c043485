"""Outlets, seen by real inlets: what is pushed, what is refused, what is counted."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pylsl
import pytest
from numpy.typing import ArrayLike

from biosensor_common.spec import FROM_DEVICE, DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr import SPEC
from biosensor_gateway.streaming import outlets as module
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.outlets import DeviceOutlets, Outlet
from tests.rigs.gateway import inlet, visible
from tests.rigs.polling import wait_until

FORMATS = {
    "float32": pylsl.cf_float32,
    "double64": pylsl.cf_double64,
    "string": pylsl.cf_string,
    "int32": pylsl.cf_int32,
    "int16": pylsl.cf_int16,
    "int8": pylsl.cf_int8,
}
INFO = DeviceInfo("Maker", "Model", "SN 1", "2.0")
NAN, INF = math.nan, math.inf


def outlet_of(unit: str, data_name: str, sensor_name: str = "zephyr") -> Outlet:
    stream = declaration(sensor_name).stream(data_name)
    return Outlet(stream, DeviceIdentity(sensor_name, unit), INFO)


def now(*offsets_s: float) -> list[float]:
    start = pylsl.local_clock()
    return [start + offset for offset in offsets_s]


def pull(inlet: pylsl.StreamInlet, count: int) -> tuple[list[list[Any]], list[float]]:
    samples: list[list[Any]] = []
    stamps: list[float] = []
    while len(stamps) < count:
        sample, stamp = inlet.pull_sample(timeout=20.0)
        assert sample is not None
        assert stamp is not None
        samples.append(sample)
        stamps.append(stamp)
    return samples, stamps


@pytest.fixture(autouse=True)
def attach_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Receivers are there from the start here."""
    monkeypatch.setattr(module, "ATTACH_TIME_S", 0.0)


@pytest.mark.seam
@pytest.mark.parametrize(
    ("data_name", "samples"),
    [
        ("ecg", [[0.0], [512.0], [1023.0]]),
        ("ecg", [[NAN], [512.0], [NAN]]),
        ("acc", [[-1.0, 0.25, 0.5], [0.0, NAN, 1.0], [24.5, -24.5, 0.0]]),
        ("hr", [[0], [71], [255]]),
        ("hrv", [[0], [103], [65535]]),
        ("quality", [[1, 100, 0, 0, NAN, 254], [0, NAN, 1, 1, 1, NAN], [1, 1, 1, 1, 1, 1]]),
    ],
)
def test_values_and_stamps_arrive_as_they_were_pushed(
    unit: str, data_name: str, samples: list[list[float]]
) -> None:
    outlet = outlet_of(unit, data_name)
    reader = inlet(outlet.source_id)
    # Unevenly spaced: no stamp may be made up from the rate.
    stamps = now(-1.0, -0.9, -0.1)
    assert outlet.push(samples, stamps) is None
    received, received_stamps = pull(reader, 3)
    np.testing.assert_array_equal(received, samples)
    assert received_stamps == stamps
    assert outlet.counters == Counters(pushed=3, last_stamp=stamps[-1])


@pytest.mark.nightly
def test_one_channel_needs_no_second_dimension(unit: str) -> None:
    outlet = outlet_of(unit, "ecg")
    reader = inlet(outlet.source_id)
    assert outlet.push([1, 2, 3], now(0, 0.004, 0.008)) is None
    assert pull(reader, 3)[0] == [[1.0], [2.0], [3.0]]


@pytest.mark.seam
def test_text_arrives(unit: str) -> None:
    outlet = outlet_of(unit, "counters", "gateway")
    reader = inlet(outlet.source_id)
    (stamp,) = now(0)
    text = counters_text({"a-b": Counters(5, 4, 3, 2.5)})
    outlet.push_text(text, stamp)
    assert pull(reader, 1) == ([[text]], [stamp])
    assert text == '{"a-b":{"pushed":5,"lost":4,"last_stamp":2.5}}'
    assert outlet.counters == Counters(pushed=1, last_stamp=stamp)


@pytest.mark.parametrize(
    ("data_name", "samples", "offsets_s", "words"),
    [
        ("ecg", [[1, 2]], [0], "shape"),
        ("acc", [1, 2, 3], [0], "shape"),
        # As many numbers as two samples of three channels have.
        ("acc", [[1, 2], [3, 4], [5, 6]], [0, 0.02], "shape"),
        ("acc", [[1, 2, 3]], [0, 0.02], "shape"),
        ("ecg", [1, 2, 3], [0, 0.004], "shape"),
        ("ecg", [1], [], "shape"),
        ("ecg", [1, 2], [0, -0.004], "backwards"),
        ("ecg", [1, 2], [0, NAN], "backwards"),
        ("ecg", [1], [INF], "backwards"),
        ("ecg", [1, 2], [0, 1e6], "not on the LSL clock"),
        ("ecg", [1], [1.7e9], "not on the LSL clock"),
        ("ecg", [1], [module.MAX_STAMP_ERROR_S + 5], "not on the LSL clock"),
        ("ecg", [1], [-module.MAX_STAMP_AGE_S - 5], "not on the LSL clock"),
        ("ecg", [INF], [0], "infinite"),
        ("acc", [[0, 0, -INF]], [0], "infinite"),
        ("hr", [INF], [0], "infinite"),
        # Finite as it is given, and infinite in the format of the stream.
        ("breathing", [1e39], [0], "infinite"),
        ("ibi", [NAN], [0], "irregular"),
        ("quality", [[1] * 6, [NAN] * 6], [0, 1], "irregular"),
        ("hr", [NAN], [0], "no value"),
        ("hr", [256], [0], "outside 0..255"),
        ("hr", [-1], [0], "outside 0..255"),
        ("hrv", [65536], [0], "outside 0..65535"),
    ],
)
def test_what_must_not_be_published_is_refused_whole_and_counted(
    unit: str, data_name: str, samples: ArrayLike, offsets_s: Sequence[float], words: str
) -> None:
    outlet = outlet_of(unit, data_name)
    refusal = outlet.push(samples, now(*offsets_s))
    assert refusal is not None
    assert words in refusal
    assert outlet.counters == Counters(refused=len(offsets_s))


def test_an_integer_stream_takes_no_gaps_even_if_it_is_regular(unit: str) -> None:
    stream = replace(SPEC.stream("hr"), rate=4.0)
    outlet = Outlet(stream, DeviceIdentity("zephyr", unit), INFO)
    assert "integer" in (outlet.push([70, NAN], now(0, 0.25)) or "")


@pytest.mark.nightly
def test_a_refusal_takes_nothing_from_what_follows(unit: str) -> None:
    outlet = outlet_of(unit, "ecg")
    reader = inlet(outlet.source_id)
    first, second, third = now(-0.2, -0.1, 0)
    assert outlet.push([1], [second]) is None
    assert "backwards" in (outlet.push([2], [first]) or "")
    assert outlet.push([3, 4], [second, third]) is None
    assert pull(reader, 3) == ([[1.0], [3.0], [4.0]], [second, second, third])
    assert outlet.counters == Counters(pushed=3, refused=1, last_stamp=third)


def test_no_samples_are_no_fault(unit: str) -> None:
    outlet = outlet_of(unit, "ecg")
    assert outlet.push([], []) is None
    assert outlet_of(f"{unit}x", "acc").push(np.empty((0, 3)), []) is None
    assert outlet.counters == Counters()


def text_of(element: Element, path: str) -> str | None:
    found = element.find(path)
    return None if found is None else found.text


@pytest.mark.nightly
@pytest.mark.parametrize("stream", SPEC.streams, ids=lambda stream: stream.data_name)
def test_a_stream_describes_itself(unit: str, stream: StreamSpec) -> None:
    identity = DeviceIdentity("zephyr", unit, participant="p01", label=f"l{unit[:6]}")
    outlet = Outlet(stream, identity, INFO)
    info = inlet(outlet.source_id).info(20.0)
    assert (info.name(), info.type()) == (outlet.name, stream.content_type.value)
    assert info.name().isascii()
    assert info.channel_count() == len(stream.channels)
    assert info.nominal_srate() == pytest.approx(stream.rate)
    assert info.channel_format() == FORMATS[stream.format.value]
    desc = fromstring(info.as_xml()).find("desc")
    assert desc is not None
    channels = [(text_of(node, "label"), text_of(node, "unit")) for node in desc.iter("channel")]
    assert channels == [(channel.label, channel.unit) for channel in stream.channels]
    assert all(text_of(node, "type") for node in desc.iter("channel"))
    fields = ("manufacturer", "model", "serial_number", "firmware_version")
    assert [text_of(desc, f"acquisition/{field}") for field in fields] == [
        "Maker", "Model", "SN 1", "2.0"
    ]  # fmt: skip
    can_drop = text_of(desc, "synchronization/can_drop_samples")
    assert can_drop == ("true" if stream.is_regular else None)
    assert text_of(desc, "biosensor/data_name") == stream.data_name
    assert text_of(desc, "biosensor/unit") == unit
    assert text_of(desc, "biosensor/participant") == "p01"


def test_a_rate_must_be_known(unit: str) -> None:
    stream = replace(SPEC.stream("ecg"), rate=FROM_DEVICE)
    with pytest.raises(TypeError, match="ecg"):
        Outlet(stream, DeviceIdentity("zephyr", unit), INFO)


@pytest.fixture
def device(unit: str) -> Generator[DeviceOutlets]:
    # Force and rate of the belt are declared "from the device".
    outlets = DeviceOutlets(
        DeviceIdentity("vernier_respiration_belt", unit), declaration("vernier_respiration_belt")
    )
    yield outlets
    outlets.close()


RATES = {"bpm": 0.1, "force": 10.0}


@pytest.mark.nightly
def test_outlets_survive_a_second_opening(device: DeviceOutlets) -> None:
    device.open(DeviceInfo(), RATES)
    force, reader = device["force"], inlet(device["force"].source_id)
    force.push([1.0], now(0))
    force.counters.lost += 7
    device.open(DeviceInfo(firmware_version="3.0"), RATES)
    assert device["force"] is force
    device["force"].push([2.0], now(0))
    assert pull(reader, 2)[0] == [[1.0], [2.0]]
    assert device.counters[force.source_id].lost == 7


@pytest.mark.nightly
def test_only_the_outlet_whose_rate_changed_is_rebuilt_under_its_source_id(
    device: DeviceOutlets,
) -> None:
    device.open(DeviceInfo(), RATES)
    before = {name: device[name] for name in ("bpm", "force", "bat")}
    ids = {name: outlet.source_id for name, outlet in before.items()}
    uid = inlet(ids["force"]).info(20.0).uid()
    del before["force"]
    device.open(DeviceInfo(), RATES | {"force": 20.0})
    assert all(device[name] is outlet for name, outlet in before.items())
    info = inlet(ids["force"]).info(20.0)
    assert info.nominal_srate() == 20.0
    assert info.uid() != uid
    assert {name: device[name].source_id for name in ids} == ids


KNOWN = DeviceInfo(firmware_version="2.4")


def test_expected_outlets_are_kept_if_the_device_is_as_it_was(device: DeviceOutlets) -> None:
    assert device.expect(KNOWN, RATES)
    force = device["force"]
    assert device.open(KNOWN, RATES) == {}
    assert device["force"] is force


@pytest.mark.nightly
def test_expected_outlets_are_replaced_if_the_device_is_another(device: DeviceOutlets) -> None:
    assert device.expect(KNOWN, RATES)
    before = inlet(device["bat"].source_id).info(20.0).uid()
    assert device.open(DeviceInfo(firmware_version="2.5"), RATES | {"force": 20.0}) == {
        "force": (10.0, 20.0)
    }
    info = inlet(device["bat"].source_id).info(20.0)
    assert info.uid() != before
    assert "<firmware_version>2.5<" in info.as_xml()
    battery = device["bat"]
    device.open(KNOWN, RATES | {"force": 20.0})
    assert device["bat"] is battery


def test_nothing_is_expected_without_the_rates_that_a_device_sets(device: DeviceOutlets) -> None:
    assert not device.expect(KNOWN, {"bpm": 0.1})
    assert device.counters == {}


@pytest.mark.nightly
def test_the_declaration_fills_what_the_device_does_not_say(device: DeviceOutlets) -> None:
    device.open(DeviceInfo(serial_number="0K2"), RATES)
    xml = inlet(device["bat"].source_id).info(20.0).as_xml()
    acquisition = fromstring(xml).find("desc/acquisition")
    assert acquisition is not None
    declared = declaration("vernier_respiration_belt")
    assert text_of(acquisition, "manufacturer") == declared.manufacturer
    assert text_of(acquisition, "model") == declared.model
    assert text_of(acquisition, "serial_number") == "0K2"


@pytest.mark.seam
def test_closing_makes_the_streams_vanish(device: DeviceOutlets) -> None:
    device.open(DeviceInfo(), RATES)
    source_id = device["force"].source_id
    wait_until(lambda: visible(source_id))
    device.close()
    wait_until(lambda: not visible(source_id))
    assert device.counters == {}


@pytest.mark.seam
def test_states_wait_for_a_receiver(unit: str) -> None:
    outlet = outlet_of(unit, "bat")
    stamps = now(0.0, 0.1)
    for value, stamp in zip((81.0, 80.0), stamps, strict=True):
        assert outlet.push([value], [stamp]) is None
    outlet.release()
    assert outlet.counters == Counters()
    reader = inlet(outlet.source_id)
    outlet.release()
    assert pull(reader, 2) == ([[81.0], [80.0]], stamps)
    assert outlet.counters == Counters(pushed=2, last_stamp=stamps[-1])


@pytest.mark.nightly
def test_states_leave_time_to_attach(unit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ATTACH_TIME_S", 3600.0)
    outlet = outlet_of(unit, "rssi")
    reader = inlet(outlet.source_id)
    outlet.push([-60.0], now(0.0))
    outlet.release()
    assert reader.pull_sample(timeout=0.5) == (None, None)
    assert outlet.counters.pushed == 0


@pytest.mark.nightly
def test_waiting_states_come_before_later_ones(unit: str) -> None:
    outlet = outlet_of(unit, "bat")
    stamps = now(0.0, 0.1)
    outlet.push([50.0], stamps[:1])
    reader = inlet(outlet.source_id)
    outlet.push([49.0], stamps[1:])
    assert pull(reader, 2) == ([[50.0], [49.0]], stamps)


def test_what_is_no_state_does_not_wait(unit: str) -> None:
    outlet = outlet_of(unit, "hr")
    outlet.push([70], now(0.0))
    assert outlet.counters.pushed == 1


@pytest.mark.nightly
def test_a_declared_state_waits_whatever_its_type(unit: str) -> None:
    stream = replace(SPEC.stream("posture"), is_state=True)
    outlet = Outlet(stream, DeviceIdentity("zephyr", unit), INFO)
    outlet.push([70.0], now(0.0))
    assert (outlet.counters.pushed, outlet.counters.waited) == (0, 1)


@pytest.mark.seam
def test_after_a_kill_samples_wait_for_those_who_return(
    unit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "RETURN_TIME_S", 0.0)
    monkeypatch.setattr(module, "LATEST_RETURN_S", 3600.0)
    outlet = outlet_of(unit, "ecg")
    outlet.await_return()
    stamps = now(*(index / 250 for index in range(1001)))
    values = [[float(index % 1024)] for index in range(1001)]
    outlet.push(values[:-1], stamps[:-1])
    assert outlet.counters.pushed == 0
    reader = inlet(outlet.source_id)
    outlet.push(values[-1:], stamps[-1:])
    assert pull(reader, 1001) == (values, stamps)
    assert outlet.counters.pushed == 1001


@pytest.mark.nightly
def test_who_returns_first_does_not_take_it_from_the_others(
    unit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "RETURN_TIME_S", 3600.0)
    outlet = outlet_of(unit, "ecg")
    outlet.await_return()
    reader = inlet(outlet.source_id)
    outlet.push([1.0], now(0.0))
    outlet.release()
    assert reader.pull_sample(timeout=0.5) == (None, None)
    assert outlet.counters.pushed == 0


def test_who_does_not_return_is_not_awaited_for_ever(
    unit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "RETURN_TIME_S", 0.0)
    monkeypatch.setattr(module, "LATEST_RETURN_S", 0.0)
    outlet = outlet_of(unit, "ecg")
    outlet.await_return()
    outlet.push([1.0], now(0.0))
    assert outlet.counters.pushed == 1
