"""The driver reads the virtual device, and values against vectors and any bytes."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common import plausible
from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.bluetooth_health import SPEC
from biosensor_gateway.devices.bluetooth_health.driver import HealthEmitter, recognise
from biosensor_gateway.devices.bluetooth_health.driver.services import (
    ROWS,
    SPOT_CHECK,
    Revolutions,
    long_float,
    sfloat,
)
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.nearby import Advertisement
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from biosensor_gateway.devices.bluetooth_health.simulator import SimulatedHealthDevice

# The driver reads the virtual device, on every rig.

STREAMS = ("spo2", "temp", "running", "power")


async def test_every_stream_fills_with_what_the_device_sent(device: SimulatedHealthDevice) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(4, *STREAMS, "cycling", "quality"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        assert run.sink.info.manufacturer == "Virtual Health"
    for name in STREAMS:
        assert_once_and_in_order(run.sink.rows[name], device.truth.samples(name).values)
    # Two turns a second of 2.105 m, and 75 of the crank a minute.
    np.testing.assert_allclose(np.nanmedian(run.sink.rows["cycling"], axis=0), [4.21, 75.0], 1e-3)
    assert set(run.sink.values("quality")) == {1}
    assert run.sink.rows["bat"] == [[87]]
    assert run.sink.rows["rssi"] == [[-67]]
    assert run.sink.dropped_bytes == 0


@ON_BUMBLE
async def test_without_a_finger_there_is_no_saturation(device: SimulatedHealthDevice) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(2, "spo2"))
        device.apply(Fault(FaultKind.OFF_BODY, 3600.0))
        await until(lambda: run.sink.values("quality")[-1] == 0)
        count = len(run.sink.rows["spo2"])
        await run.goes_on(3, "temp")
        assert len(run.sink.rows["spo2"]) == count
        assert run.supervisor.connections == 1


@ON_BUMBLE
async def test_services_that_it_does_not_have_are_not_waited_for(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    has = BleLink.has

    def without_oximeter(link: BleLink, uuid: str) -> bool:
        return "2a5f" not in uuid and has(link, uuid)

    monkeypatch.setattr(BleLink, "has", without_oximeter)
    async with connected(device) as info:
        assert info.refused == {"spo2"}
        assert not info.due


@ON_BUMBLE
async def test_a_device_without_any_is_said(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def has_nothing(_link: BleLink, _uuid: str) -> bool:
        return False

    monkeypatch.setattr(BleLink, "has", has_nothing)
    with pytest.raises(ProtocolError, match="has none of the services") as caught:
        async with connected(device):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@pytest.mark.parametrize("service", ["1822", "1809", "1814", "1816", "1818"])
def test_a_device_is_found_by_any_of_its_services(service: str) -> None:
    uuid = f"0000{service}-0000-1000-8000-00805f9b34fb"
    seen = Advertisement("C8:26:00:00:00:01", "Nonin3230_1", -60, frozenset({uuid}))
    found = recognised(drivers_by_precedence(), seen)
    assert found is not None
    assert (found.sensor, found.name) == ("bluetooth_health", "Nonin3230_1")


@ON_BUMBLE
async def test_an_oximeter_with_spot_checks_alone_is_told_from_others(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def has(link: BleLink, uuid: str) -> bool:
        del link
        return uuid == SPOT_CHECK

    monkeypatch.setattr(BleLink, "has", has)
    with pytest.raises(ProtocolError, match="makes only spot checks"):
        async with connected(device):
            pass


def test_anything_else_is_none() -> None:
    assert recognise(Advertisement("C8:26:00:00:00:01", "Nonin3230_1", -60)) is None


# Values of characteristics, against vectors and against any bytes.
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/bluetooth_health.json").read_text(encoding="utf-8")
)
BY_STREAM = {row.stream: row for row in ROWS}


def of_kind(kind: str) -> pytest.MarkDecorator:
    found = [vector for vector in VECTORS if vector["kind"] == kind]
    return pytest.mark.parametrize("vector", found, ids=[vector["name"] for vector in found])


@of_kind("value")
def test_a_value_makes_the_sample_that_it_means(vector: dict[str, Any]) -> None:
    row = BY_STREAM[vector["stream"]]
    found = row.parse(bytes.fromhex(vector["hex"]))
    if vector["expected"] == "cut":
        assert found is None
        return
    assert found is not None
    is_off = row.contact is not None and row.contact(found) is False
    sample = None if is_off else row.sample(2.1)(found, 0.0)
    expected = vector["expected"]
    if expected is None:
        assert sample is None
    else:
        wanted = [math.nan if each is None else each for each in expected]
        assert sample == pytest.approx(wanted, nan_ok=True)


@of_kind("fields")
def test_a_value_has_the_counts_that_another_program_reads(vector: dict[str, Any]) -> None:
    found = BY_STREAM[vector["stream"]].parse(bytes.fromhex(vector["hex"]))
    assert found is not None
    turns = {name: found[name] for name in found if name.endswith("_turns")}
    assert turns == vector["expected"]


@of_kind("sfloat")
def test_decimal_numbers_of_16_bits(vector: dict[str, Any]) -> None:
    number = sfloat(bytes.fromhex(vector["hex"]))
    expected = math.nan if vector["expected"] is None else vector["expected"]
    assert number == pytest.approx(expected, nan_ok=True)


@given(st.integers(-2045, 2045), st.integers(-8, 7))
def test_any_decimal_number_is_read_as_it_was_written(mantissa: int, exponent: int) -> None:
    short = (mantissa & 0xFFF | (exponent & 0xF) << 12).to_bytes(2, "little")
    long = (mantissa & 0xFFFFFF | (exponent & 0xFF) << 24).to_bytes(4, "little")
    assert sfloat(short) == long_float(long) == pytest.approx(mantissa * 10.0**exponent)


@given(st.binary(max_size=40), st.sampled_from(ROWS))
def test_any_bytes_make_a_sample_of_the_declaration_or_none(data: bytes, row: Any) -> None:
    found = row.parse(data)
    if found is None:
        return
    sample = row.sample(2.1)(found, 0.0)
    assert sample is None or len(sample) == len(SPEC.stream(row.stream).channels)
    if row.contact is not None:
        assert row.contact(found) in (True, False)


def test_every_row_has_a_stream_and_a_service_of_its_own() -> None:
    assert set(BY_STREAM) <= {stream.data_name for stream in SPEC.streams}
    for part in ("stream", "service", "characteristic"):
        assert len({getattr(row, part) for row in ROWS}) == len(ROWS)


def test_turns_are_rates_over_roll_overs_and_standstill() -> None:
    wheel = Revolutions(16)
    assert math.isnan(wheel.rate(65535, 65024, 0.0))
    # Two turns in a second.
    assert wheel.rate(1, 512, 1.0) == pytest.approx(2.0)
    assert math.isnan(wheel.rate(1, 512, 2.0))
    assert wheel.rate(1, 512, 4.5) == 0.0
    assert math.isnan(wheel.rate(None, None, 5.0))


@pytest.mark.parametrize("bits", [0, 16])
@pytest.mark.parametrize("turns", [1, -1, 900])
@pytest.mark.parametrize("ticks", [0, -1, -1024])
def test_turns_whose_time_stands_still_or_steps_back_are_no_rate_that_is_believed(
    bits: int, turns: int, ticks: int
) -> None:
    low, high = plausible.SPEED_M_S
    wheel = Revolutions(bits)
    wheel.rate(1000, 40_000, 0.0)
    # Neither a speed nor a standstill, however long it goes on.
    for second in range(1, 8):
        rate = wheel.rate(1000 + second * turns, 40_000 + second * ticks, float(second))
        assert not low <= 0.1 * rate <= high


def test_a_long_stop_is_as_long_as_it_was() -> None:
    """The device's clock of 16 bits has rolled over meanwhile."""
    wheel = Revolutions(0)
    wheel.rate(10, 0, 1.0)
    assert wheel.rate(12, 1024, 2.0) == 2.0
    for second in range(3, 67):
        assert wheel.rate(12, 1024, float(second)) in (0.0, pytest.approx(math.nan, nan_ok=True))
    ticks = round(1024 * 66.5) % 65536
    assert wheel.rate(13, ticks, 67.6) == pytest.approx(1 / 65.5)


@pytest.mark.parametrize(
    ("stream", "value", "lacking"),
    [
        ("spo2", struct.pack("<BHH", 0, 97, 72), ["PAI"]),
        ("spo2", struct.pack("<BHHH", 16, 97, 72, 3), []),
        ("cycling", struct.pack("<BLH", 1, 7, 512), ["cadence"]),
        ("cycling", struct.pack("<BHH", 2, 7, 512), ["speed"]),
    ],
)
def test_fields_that_a_device_does_not_have_are_not_missing(
    stream: str, value: bytes, lacking: list[str]
) -> None:
    sink = EmitterSink("bluetooth_health")
    row = next(row for row in ROWS if row.stream == stream)
    HealthEmitter(sink, 2.1).take(row, value, 1.0)
    assert sink.lacking[stream] == lacking


@pytest.mark.parametrize(
    ("saturation", "pulse", "sample", "contact"),
    [
        (0x07FF, 72, [math.nan, 72.0, math.nan], True),
        (97, 0x07FF, [97.0, math.nan, math.nan], True),
        (0x07FF, 0x07FF, None, False),
        (0, 0, [0.0, 0.0, math.nan], False),
        (0, 0x07FF, [0.0, math.nan, math.nan], False),
    ],
)
def test_what_an_oximeter_finds_does_not_wait_for_the_rest(
    saturation: int, pulse: int, sample: list[float] | None, contact: bool
) -> None:
    row = next(row for row in ROWS if row.stream == "spo2")
    found = row.parse(struct.pack("<BHH", 0, saturation, pulse))
    assert found is not None
    assert row.sample(1.0)(found, 0.0) == (sample and pytest.approx(sample, nan_ok=True))
    assert row.contact is not None
    assert row.contact(found) is contact
