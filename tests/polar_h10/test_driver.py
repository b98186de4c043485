"""The driver streams from virtual Polar sensors, and what it asks of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import contextmanager
from math import inf
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.errors import CredentialError, ProtocolError, ProtocolReason
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_h10 import driver as driver_module
from biosensor_gateway.devices.polar_h10.driver import (
    PolarDriver,
    PolarH10Settings,
    identify,
    recognise,
)
from biosensor_gateway.devices.polar_h10.driver import control as control_module
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Firmware, Quirks
from biosensor_gateway.simulation.central import GattLink
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports import ble
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.nearby import Advertisement
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order, assert_only_gaps

# The driver streams from virtual Polar sensors: all of it, once, at the right time.

MakeSensor = Callable[..., SimulatedPolarH10]


@pytest.mark.parametrize("rate", [25, 200])
async def test_the_rate_of_the_settings_is_the_stream_s(sensor: MakeSensor, rate: int) -> None:
    async with connected(sensor(), acc_rate_hz=rate) as info:
        assert info.rates == {"ecg": 130, "acc": rate}
        assert (info.info.manufacturer, info.info.model) == ("Polar Electro Oy", "H10")
        assert info.info.serial_number == "A1B2C3D4"


async def test_what_is_not_wanted_is_not_started(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10, ecg=False, acc=False) as run:
        await until(run.sink.has(2, "hr", "ibi"))
    assert (run.sink.rows["ecg"], run.sink.rows["acc"]) == ([], [])
    assert "ecg" not in h10.truth.data_names
    async with connected(sensor(), ecg=False) as info:
        assert (info.silent, set(info.rates)) == ({"ecg"}, {"acc"})


@pytest.mark.parametrize("firmware", [Firmware.OLD, Firmware.HEART_RATE_ONLY])
async def test_without_a_pmd_service_it_is_a_heart_rate_strap(
    sensor: MakeSensor, firmware: Firmware
) -> None:
    h10 = sensor(Quirks(firmware=firmware))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(1, "hr", "ibi", "quality"))
            h10.apply(Fault(FaultKind.DROP, 0.2))
            await until(lambda: run.supervisor.connections == 2)
            await run.goes_on(1, "hr")
    assert sum("update it with Polar Flow" in entry["event"] for entry in logs) == 1
    assert run.sink.rows["ecg"] == []


@pytest.mark.parametrize("host_mtu", [64])
async def test_a_small_mtu_is_enough(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(200, "ecg"))
        await until(run.sink.has(50, "acc"))
        assert run.sink.lost_count("ecg") == 0
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_compressed_acceleration_is_the_same(sensor: MakeSensor) -> None:
    h10 = sensor(Quirks(compressed_acceleration=True))
    async with streaming(h10) as run:
        await until(run.sink.has(100, "acc"))
        assert run.sink.lost_count("acc") == 0
    assert_only_gaps(h10, run.sink, "ecg", "acc")


# What the driver asks of a Polar sensor, what it makes of the answers, and pairing.
@contextmanager
def noted_writes(monkeypatch: pytest.MonkeyPatch) -> Generator[list[str]]:
    """Note what the host asks, in order."""
    asked: list[str] = []
    originals = {name: getattr(BleLink, name) for name in ("read", "write", "subscribe")}

    def noting(name: str) -> Callable[..., Any]:
        async def ask(link: BleLink, uuid: str, *arguments: Any, **options: Any) -> Any:
            data = arguments[0].hex() if arguments else ""
            asked.append(f"{name} {uuid[4:8]} {data}".strip())
            return await originals[name](link, uuid, *arguments, **options)

        return ask

    with monkeypatch.context() as patch:
        for name in originals:
            patch.setattr(BleLink, name, noting(name))
        yield asked


async def test_the_control_point_is_spoken_to_in_the_vendor_s_order(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor()
    with noted_writes(monkeypatch) as asked:
        async with connected(h10, acc_rate_hz=100, acc_range_g=4):
            pass
    about_pmd = [each for each in asked if " 5c8" in each]
    assert about_pmd == [
        "read 5c81",
        "subscribe 5c81",
        "subscribe 5c82",
        "write 5c81 0100",
        "write 5c81 02000001820001010e00",
        "write 5c81 0102",
        "write 5c81 0202000164000101100002010400",
        "write 5c81 0300",
        "write 5c81 0302",
    ]


async def test_a_former_host_s_measurements_are_stopped_first(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    quirks = Quirks(left_streaming=(Measurement.ECG, Measurement.ACC), short_errors=True)
    h10 = sensor(quirks)
    with noted_writes(monkeypatch) as asked:
        async with streaming(h10) as run:
            await until(run.sink.has(73, "ecg"))
            await until(run.sink.has(36, "acc"))
    starts = [each for each in asked if each.startswith(("write 5c81 0200", "write 5c81 0300"))]
    assert [each[11:15] for each in starts[:3]] == ["0200", "0300", "0200"]
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_the_device_is_left_still(sensor: MakeSensor) -> None:
    """One that is left measuring empties its battery."""
    h10 = sensor(Quirks(keeps_streaming=True))
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
    sent = len(h10.truth.samples("ecg").times)
    async with connected(h10, ecg=False, acc=False):
        # Longer than a frame.
        await asyncio.sleep(0.8)
        assert len(h10.truth.samples("ecg").times) == sent


async def test_a_device_that_never_answers_is_an_error(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert control_module.REPLY_TIMEOUT_S == 5.0
    monkeypatch.setattr(control_module, "REPLY_TIMEOUT_S", 0.3)
    h10 = sensor()
    h10.apply(Fault(FaultKind.LATE, 30.0))
    with pytest.raises(ProtocolError) as caught:
        async with connected(h10):
            pass
    assert caught.value.reason is ProtocolReason.NO_REPLY


async def test_a_device_that_demands_pairing_is_paired(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))
    paired: list[str] = []
    original = BleLink.pair

    async def pair(link: BleLink) -> None:
        paired.append(link.what)
        await original(link)

    monkeypatch.setattr(BleLink, "pair", pair)
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        assert run.supervisor.connections == 1
        assert run.supervisor.last_error is None
        assert len(paired) == 1
        # The bond holds.
        h10.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(73, "ecg")
        assert len(paired) <= 2
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_pairing_may_come_first(sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        raise AssertionError(f"{link.what} is paired already")

    monkeypatch.setattr(BleLink, "pair", pair)
    async with connected(h10, pair=True) as info:
        assert info.rates["ecg"] == 130


async def test_a_device_that_cannot_be_paired_is_a_matter_of_credentials(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        """Do as a system does that believes it is paired already."""

    monkeypatch.setattr(BleLink, "pair", pair)
    with pytest.raises(CredentialError, match="remove the sensor in the system's Bluetooth"):
        async with connected(h10):
            pass


# Which advertisements are those of an H10, and the settings they make.
HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})
POLAR = {0x006B: bytes.fromhex("33000038")}


def seen(name: str, uuids: frozenset[str] = HEART_RATE) -> Advertisement:
    return Advertisement("A0:9E:1A:00:00:01", name, -58, uuids)


def test_the_id_on_the_sensor_names_it_and_its_address_leads_to_it() -> None:
    found = recognise(seen("Polar H10 A1B2C3D4"))
    assert found is not None
    assert (found.sensor, found.rssi_dbm) == ("polar_h10", -58)
    assert found.name == "Polar H10 A1B2C3D4"
    settings = PolarH10Settings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("A1B2C3D4", "A0:9E:1A:00:00:01")


def test_the_maker_s_number_is_as_good_as_the_service() -> None:
    name = "Polar H10 A1B2C3D4"
    assert identify(Advertisement("A0:9E:1A:00:00:01", name, manufacturer_data=POLAR)) == "A1B2C3D4"
    assert identify(seen(name, frozenset())) is None


@pytest.mark.parametrize(
    "name",
    [
        "",
        "   ",
        "Polar",
        "Polar H10",
        "Polar H9 A1B2C3D4",
        "Polar Sense A1B2C3D4",
        "Polar Vantage V3 A1B2C3D4",
        "Polaris H10 A1B2C3D4",
        "My Polar H10 A1B2C3D4",
    ],
)
def test_other_names_are_other_devices(name: str) -> None:
    assert identify(seen(name)) is None
    assert recognise(seen(name)) is None


@given(st.text(max_size=60))
def test_no_name_is_too_strange(name: str) -> None:
    assert identify(seen(name)) is None or name.split(maxsplit=1)[0] == "Polar"


# Whatever a Polar sensor refuses or loses, the driver goes on with what there is.

# Whatever happens to a Polar sensor or the link to it, the driver comes back and says so.

MakeSteered = Callable[..., SteeredPolarH10]


async def after_a_break(run: Run, break_it: Callable[[], None]) -> None:
    await until(run.sink.has(100, "ecg"))
    await until(run.sink.has(36, "acc"))
    break_it()
    await until(lambda: State.DISCOVERING in run.states)
    ecg, acc = len(run.sink.rows["ecg"]), len(run.sink.rows["acc"])
    await until(run.sink.has(ecg + 100, "ecg"))
    await until(run.sink.has(acc + 36, "acc"))
    await until(run.sink.has(1, "bat"))


async def test_measurements_that_went_on_are_started_again(sensor: MakeSteered) -> None:
    h10 = sensor(Quirks(keeps_streaming=True, announces_stops=True))
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.DROP, 0.8)))
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_a_measurement_that_stops_is_started_again(
    sensor: MakeSteered, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert driver_module.PATIENCE_S == 5.0
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.5)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        with capture_logs() as logs:
            h10.stop_measurements(Measurement.ECG)
            await run.goes_on(146, "ecg")
        assert run.supervisor.connections == 1
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run.sink, "ecg", "acc")
    said = [entry["event"] for entry in logs]
    assert "the device stopped measuring" in said
    assert any("no data of ecg" in each and "enabling again" in each for each in said)
    assert lost > 100


async def test_a_silent_device_is_connected_again(
    sensor: MakeSteered, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert PolarDriver.silence_limit_s == 15.0
    monkeypatch.setattr(ble, "REQUEST_LIMIT_S", 0.5)
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.0)
    monkeypatch.setattr(driver_module, "FULL_FRAME", 20)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        h10.apply(Fault(FaultKind.STALL, inf))
        await until(lambda: State.DISCOVERING in run.states)
        assert "no data of acc, ecg" in str(run.supervisor.last_error)
        h10.clear(FaultKind.STALL)
        await run.goes_on(73, "ecg")
        assert run.supervisor.connections >= 2
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_a_heart_rate_that_stops_alone_is_subscribed_to_again(
    sensor: MakeSteered, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "DUE", {"hr": 2.0})
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(2, "hr"))
        h10.forget_heart_rate()
        await until(lambda: State.ENABLING in run.states)
        assert "no data of hr" in str(run.supervisor.last_error)
        await run.goes_on(2, "hr")
        await until(lambda: run.supervisor.last_error is None)
        assert run.supervisor.connections == 1
        assert run.sink.lost_count("ecg") == 0
    assert_only_gaps(h10, run.sink, "ecg", "acc")


# A sensor that refuses to measure still has a heart rate, and is asked again.
MakeRefusing = Callable[..., SimulatedPolarH10]


@ON_BUMBLE
async def test_without_the_mtu_for_it_there_is_a_heart_rate_and_a_reason(
    sensor: MakeRefusing,
) -> None:
    h10 = sensor(Quirks(minimum_mtu=512))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(12, "hr", "quality"))
            await until(run.sink.has(5, "ibi"))
            # Nothing is given for it: neither the connection nor the state.
            assert run.supervisor.connections == 1
            assert run.states == [State.CONNECTING, State.STREAMING]
            assert run.supervisor.last_error == (
                "connected, but the device refuses acc, ecg (INVALID_MTU: its packets are too "
                "large for this Bluetooth adapter; use another one)"
            )
    assert_once_and_in_order(run.sink.rows["hr"], h10.truth.samples("hr").values)
    assert (run.sink.rows["ecg"], run.sink.rows["acc"]) == ([], [])
    said = [entry for entry in logs if entry["event"] == run.supervisor.last_error]
    assert [(each["log_level"], each["reason"]) for each in said] == [("warning", "refused")]


@ON_BUMBLE
async def test_what_was_refused_comes_as_soon_as_the_sensor_measures(sensor: MakeRefusing) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        h10.apply(Fault(FaultKind.REFUSE, inf))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(3, "hr")
        assert "the device refuses acc, ecg (INVALID_STATE" in str(run.supervisor.last_error)
        h10.clear(FaultKind.REFUSE)
        await run.goes_on(73, "ecg", "acc")
        await until(lambda: run.supervisor.last_error is None)
        assert run.supervisor.connections == 2
        assert State.BACKOFF not in run.states
    assert_only_gaps(h10, run.sink, "ecg", "acc")


@ON_BUMBLE
async def test_what_was_refused_has_the_rate_that_was_asked_for(sensor: MakeRefusing) -> None:
    h10 = sensor()
    h10.apply(Fault(FaultKind.REFUSE, inf))
    async with streaming(h10, acc_rate_hz=200, ecg=False) as run:
        await until(lambda: "refuses acc (" in str(run.supervisor.last_error))
        assert run.sink.rates == {"acc": 200}
        h10.clear(FaultKind.REFUSE)
        await until(run.sink.has(50, "acc"))
        assert run.supervisor.connections == 1


@ON_BUMBLE
@pytest.mark.parametrize("times", [1, 1000])
@pytest.mark.parametrize("answer", [b"", b"\x0f", b"\xf0\x01\x02\x00", bytes(17)])
async def test_a_sensor_that_does_not_say_what_it_measures_is_asked_again_and_told(
    sensor: MakeSensor, answer: bytes, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, asked = GattLink.read, list[bytes]()

    async def garbling(self: GattLink, attribute: Any) -> bytes:
        content = await read(self, attribute)
        if content[:1] != b"\x0f" or len(asked) == times:
            return content
        asked.append(content)
        return answer

    monkeypatch.setattr(GattLink, "read", garbling)
    async with streaming(sensor()) as run:
        if times == 1:
            await until(run.sink.has(2, "hr", "ecg", "acc"))
            assert not run.error
        else:
            await until(run.sink.has(2, "hr", "ibi"))
            assert "refuses acc, ecg (it does not say what it can measure" in run.error
            assert run.supervisor.connections == 1
    assert asked


@ON_BUMBLE
async def test_what_is_refused_is_told_to_who_connects(sensor: MakeRefusing) -> None:
    async with connected(sensor(Quirks(minimum_mtu=512)), acc=False) as info:
        assert info.denied.keys() == {"ecg"}
        assert (info.silent, info.refused) == ({"acc"}, {"acc"})
