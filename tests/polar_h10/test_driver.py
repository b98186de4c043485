"""The driver against virtual Polar sensors on the virtual radio, under its supervisor."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from contextlib import asynccontextmanager, contextmanager
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from structlog.testing import capture_logs

from biosensor_common.errors import CredentialError, GatewayError, ProtocolError, ProtocolReason
from biosensor_common.sensors.polar_h10 import SENSOR
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway import supervisor as supervisor_module
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.polar_h10 import control as control_module
from biosensor_gateway.devices.polar_h10 import measurements as measurements_module
from biosensor_gateway.devices.polar_h10 import session as session_module
from biosensor_gateway.devices.polar_h10.driver import DRIVER, PolarH10Driver, PolarH10Settings
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import VERITY_SENSE
from biosensor_gateway.devices.polar_h10.simulator.quirks import Firmware, Quirks
from biosensor_gateway.outlets import Counters
from biosensor_gateway.settings import DeviceSettings
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.sink import DeviceSink
from biosensor_gateway.supervisor import State, Supervisor
from biosensor_gateway.transports.ble import BleLink
from tests.rigs.polling import until

Floats = NDArray[np.float64]


class NotedSink(DeviceSink):
    """Notes what drivers emit on its way into LSL."""

    def __init__(self) -> None:
        super().__init__(DeviceIdentity("polar_h10", uuid.uuid4().hex))
        self.rows: dict[str, list[list[float]]] = {
            stream.data_name: [] for stream in SENSOR.streams
        }
        self.stamps: dict[str, list[float]] = {stream.data_name: [] for stream in SENSOR.streams}
        self._kept: dict[str, Counters] = {}

    @property
    def counters(self) -> dict[str, Counters]:
        return super().counters or self._kept

    def close(self) -> None:
        self._kept = self.counters
        super().close()

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        # Samples that the device stamps pass here as well.
        super().emit_at(data_name, samples, lsl_times)
        width = len(SENSOR.stream(data_name).channels)
        self.rows[data_name] += np.asarray(samples, np.float64).reshape(-1, width).tolist()
        self.stamps[data_name] += lsl_times

    def has(self, count: int, *data_names: str) -> Callable[[], bool]:
        return lambda: all(len(self.rows[name]) >= count for name in data_names)

    def lost_count(self, data_name: str) -> int:
        return next(
            each.lost for source, each in self.counters.items() if source.endswith(f"-{data_name}")
        )


def settings(**fields: Any) -> PolarH10Settings:
    return PolarH10Settings(sensor="polar_h10", unit=uuid.uuid4().hex, **fields)


class Run:
    """A sensor's supervisor."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self.sink = NotedSink()
        self.states: list[State] = []
        make = DRIVER.make(settings(**fields), self.sink)
        self.supervisor = Supervisor(make, self.sink, self.states.append)


@asynccontextmanager
async def streaming(twin: SimulatedPolarH10, **fields: Any) -> AsyncGenerator[Run]:
    """Run until the block ends; then nothing may have been refused or be half closed."""
    run = Run({**twin.settings, **fields})
    task = asyncio.create_task(run.supervisor.run())
    try:
        yield run
    finally:
        task.cancel()
        await asyncio.wait({task}, timeout=20)
    assert run.states[-1] is State.STOPPED
    assert {each.refused for each in run.sink.counters.values()} <= {0}
    run.sink.close()


@asynccontextmanager
async def connected(twin: SimulatedPolarH10, **fields: Any) -> AsyncGenerator[Connected]:
    """Connect once, without a supervisor."""
    driver = DRIVER.make(settings(**twin.settings, **fields), NotedSink())()
    try:
        yield await driver.connect()
    finally:
        await driver.close()


@pytest.fixture
def world() -> Generator[World]:
    with World() as world:
        yield world


@pytest.fixture
def radio(world: World) -> Generator[Radio]:
    radio = Radio(world)
    with virtual_bluetooth(radio):
        yield radio


Twins = Callable[..., Any]


@pytest.fixture
def sensor(world: World, radio: Radio) -> Generator[Twins]:
    """Switch a sensor on for the rest of the test."""
    running: list[SimulatedPolarH10] = []

    def make(quirks: Quirks | None = None, **options: Any) -> SimulatedPolarH10:
        wearer = Wearer(seed=5, heart_rate_bpm=100)
        twin = SimulatedPolarH10(world, radio, quirks=quirks, wearer=wearer, **options)
        running.append(twin.__enter__())
        return twin

    yield make
    for twin in running:
        twin.__exit__(None, None, None)


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)


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


def assert_once_and_in_order(part: list[list[float]], whole: Floats) -> list[int]:
    """Assert that all samples are the device's, each once; return where they lie."""
    received = np.asarray(part, np.float64)
    places: list[int] = []
    begin = 0
    while len(places) < len(received):
        rest = received[len(places) :]
        # Values repeat; five in a row do not.
        enough = min(5, len(rest))
        begin = next((k for k in range(begin, len(whole)) if _same(rest, whole[k:]) >= enough), -1)
        assert begin >= 0, "what was emitted is no part of what was sent"
        count = _same(rest, whole[begin:])
        places += range(begin, begin + count)
        begin += count
    return places


def _same(received: Floats, sent: Floats) -> int:
    """Count how many samples are equal, from the first one on."""
    count = min(len(received), len(sent))
    differ = ~np.all(np.isclose(received[:count], sent[:count], rtol=1e-6), axis=1)
    return int(np.argmax(differ)) if differ.any() else count


async def test_every_stream_fills_with_what_the_sensor_sent(sensor: Twins) -> None:
    h10 = sensor(rssi_dbm=-49)
    async with streaming(h10) as run:
        await until(run.sink.has(5, "hr", "ibi", "quality"))
        await until(run.sink.has(400, "ecg"))
        await until(run.sink.has(150, "acc"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        # The truth may be ahead by what is under way.
        lost = [run.sink.lost_count(stream.data_name) for stream in SENSOR.streams]
    for name in ("hr", "ibi", "ecg", "acc"):
        places = assert_once_and_in_order(run.sink.rows[name], h10.truth.samples(name).values)
        assert places == list(range(places[0], places[0] + len(places)))
    # From the first sample on.
    for name in ("ecg", "acc"):
        first = h10.truth.samples(name).values[: len(run.sink.rows[name])]
        np.testing.assert_allclose(run.sink.rows[name], first, rtol=1e-6)
    assert run.sink.rows["bat"] == [[87]]
    assert run.sink.rows["rssi"] == [[-49]]
    # Its first measurement may come before it has found a beat.
    assert [row[0] for row in run.sink.rows["quality"]][1:] == [1] * (
        len(run.sink.rows["quality"]) - 1
    )
    assert set(lost) == {0}
    assert run.sink.dropped_bytes == 0


async def test_samples_are_stamped_when_they_were_measured(sensor: Twins) -> None:
    h10 = sensor(Quirks(sampling_deviation=0.015), drift_ppm=100, jitter_s=0.05)
    async with streaming(h10) as run:
        await until(run.sink.has(1000, "ecg"))
    for name in ("ecg", "acc"):
        stamps = np.array(run.sink.stamps[name])
        errors = stamps - h10.truth.samples(name).times[: len(stamps)]
        # Not earlier than measured, and late by a radio's delay, not by a frame's 560 ms.
        assert np.all(errors > -0.02)
        assert np.median(errors) < 0.2
        assert all(a < b for a, b in pairwise(stamps))
        spacing: Floats = np.diff(errors[len(errors) // 2 :])
        assert np.sqrt(np.mean(np.square(spacing))) < 1e-3


async def test_the_control_point_is_spoken_to_in_the_vendor_s_order(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
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


@pytest.mark.parametrize("rate", [25, 200])
async def test_the_rate_of_the_settings_is_the_stream_s(sensor: Twins, rate: int) -> None:
    h10 = sensor()
    async with connected(h10, acc_rate_hz=rate) as info:
        assert info.rates == {"ecg": 130, "acc": rate}
        assert (info.info.manufacturer, info.info.model) == ("Polar Electro Oy", "H10")
        assert info.info.serial_number == "A1B2C3D4"


async def test_what_is_not_wanted_is_not_started(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10, ecg=False, acc=False) as run:
        await until(run.sink.has(3, "hr", "ibi"))
    assert (run.sink.rows["ecg"], run.sink.rows["acc"]) == ([], [])
    assert "ecg" not in h10.truth.data_names


async def test_the_strap_may_be_taken_off_and_put_on_again(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        worn: Callable[[], list[float]] = lambda: [row[0] for row in run.sink.rows["quality"]]  # noqa: E731
        await until(run.sink.has(2, "hr", "quality"))
        h10.apply(Fault(FaultKind.OFF_BODY, inf))
        await until(lambda: worn()[-2:] == [0, 0])
        beats = len(run.sink.rows["hr"])
        await until(lambda: worn()[-3:] == [0, 0, 0])
        assert len(run.sink.rows["hr"]) == beats
        h10.clear(FaultKind.OFF_BODY)
        await until(lambda: worn()[-1] == 1)
        await until(run.sink.has(beats + 1, "hr"))
        assert run.supervisor.connections == 1
    assert min(row[0] for row in run.sink.rows["hr"]) > 0


async def after_a_break(run: Run, break_it: Callable[[], None]) -> None:
    await until(run.sink.has(200, "ecg"))
    break_it()
    await until(lambda: State.DISCOVERING in run.states)
    ecg, acc = len(run.sink.rows["ecg"]), len(run.sink.rows["acc"])
    await until(run.sink.has(ecg + 100, "ecg"))
    await until(run.sink.has(acc + 40, "acc"))
    await until(run.sink.has(1, "bat"))


def assert_only_gaps(h10: SimulatedPolarH10, run: Run) -> None:
    """Assert that what arrived was sent, came once and in order, and is stamped about right."""
    for name in ("ecg", "acc"):
        truth = h10.truth.samples(name)
        places = assert_once_and_in_order(run.sink.rows[name], truth.values)
        stamps = np.array(run.sink.stamps[name])
        assert np.all(np.diff(stamps) > 0)
        assert np.max(np.abs(stamps - truth.times[places])) < 0.5


async def test_a_lost_link_is_a_gap_of_known_length(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.DROP, 1.0)))
        lost = {name: run.sink.lost_count(name) for name in ("ecg", "acc")}
    assert_only_gaps(h10, run)
    for name, rate in {"ecg": 130, "acc": 50}.items():
        stamps = np.array(run.sink.stamps[name])
        assert lost[name] == pytest.approx((np.diff(stamps) - 1 / rate).max() * rate, abs=6)


async def test_a_device_that_restarts_counts_anew_and_loses_nothing_meanwhile(
    sensor: Twins,
) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.RESTART, 1.0)))
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run)
    assert lost == 0


async def test_measurements_that_went_on_are_started_anew(sensor: Twins) -> None:
    h10 = sensor(Quirks(keeps_streaming=True, announces_stops=True))
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.DROP, 1.0)))
    assert_only_gaps(h10, run)


async def test_a_former_host_s_measurements_are_stopped_first(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    quirks = Quirks(left_streaming=(Measurement.ECG, Measurement.ACC), short_errors=True)
    h10 = sensor(quirks)
    with noted_writes(monkeypatch) as asked:
        async with streaming(h10) as run:
            await until(run.sink.has(100, "ecg"))
            await until(run.sink.has(36, "acc"))
    starts = [each for each in asked if each.startswith(("write 5c81 0200", "write 5c81 0300"))]
    assert [each[11:15] for each in starts[:3]] == ["0200", "0300", "0200"]
    assert_only_gaps(h10, run)


async def test_a_measurement_that_stops_is_started_again(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (measurements_module.RESTART_AFTER_S, measurements_module.GIVE_UP_AFTER_S) == (5, 15)
    monkeypatch.setattr(measurements_module, "RESTART_AFTER_S", 2.0)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
        with capture_logs() as logs:
            h10.stop_measurements(Measurement.ECG)
            count = len(run.sink.rows["ecg"])
            await until(run.sink.has(count + 200, "ecg"))
        assert run.supervisor.connections == 1
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run)
    assert {"the device stopped measuring", "no data; the measurement is started anew"} <= {
        entry["event"] for entry in logs
    }
    assert lost > 100


async def test_a_silent_device_is_connected_anew(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert PolarH10Driver.silence_limit_s == 15.0
    monkeypatch.setattr(measurements_module, "RESTART_AFTER_S", 1.0)
    monkeypatch.setattr(measurements_module, "GIVE_UP_AFTER_S", 3.0)
    h10 = sensor()
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.STALL, 9.0)))
        assert run.supervisor.connections >= 2
    assert_only_gaps(h10, run)


async def test_a_short_stall_only_delays(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(200, "ecg"))
        h10.apply(Fault(FaultKind.STALL, 2.0))
        await until(lambda: h10.truth.unsent_count("ecg"))
        count = len(run.sink.rows["ecg"])
        await until(run.sink.has(count + 200, "ecg"))
        assert run.supervisor.connections == 1
        lost = {name: run.sink.lost_count(name) for name in ("ecg", "acc")}
        unsent = {name: h10.truth.unsent_count(name) for name in lost}
    assert_only_gaps(h10, run)
    assert lost == unsent


async def test_a_refusal_is_told_and_overcome(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
        h10.apply(Fault(FaultKind.REFUSE, inf))
        await until(lambda: State.BACKOFF in run.states)
        assert "refuses to measure" in str(run.supervisor.last_error)
        h10.clear(FaultKind.REFUSE)
        count = len(run.sink.rows["ecg"])
        await until(run.sink.has(count + 100, "ecg"))
    assert_only_gaps(h10, run)


async def test_late_answers_are_waited_for(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
        h10.apply(Fault(FaultKind.LATE, 0.8))
        await until(lambda: run.supervisor.connections == 2)
        count = len(run.sink.rows["ecg"])
        await until(run.sink.has(count + 100, "ecg"))
    assert_only_gaps(h10, run)


async def test_a_device_that_never_answers_is_an_error(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert control_module.REPLY_TIMEOUT_S == 5.0
    monkeypatch.setattr(control_module, "REPLY_TIMEOUT_S", 0.3)
    h10 = sensor()
    h10.apply(Fault(FaultKind.LATE, 30.0))
    with pytest.raises(ProtocolError) as caught:
        async with connected(h10):
            pass
    assert caught.value.reason is ProtocolReason.NO_REPLY


async def test_garbage_is_counted_and_never_emitted(sensor: Twins) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
        h10.apply(Fault(FaultKind.GARBAGE, 20))
        await until(lambda: run.sink.dropped_bytes > 0)
        count = len(run.sink.rows["ecg"])
        await until(run.sink.has(count + 200, "ecg"))
        assert run.supervisor.connections == 1
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run)
    assert lost == 0


async def test_a_device_that_demands_pairing_is_paired(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))
    paired: list[str] = []
    original = BleLink.pair

    async def pair(link: BleLink) -> None:
        paired.append(link.what)
        await original(link)

    monkeypatch.setattr(BleLink, "pair", pair)
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
        assert run.supervisor.connections == 1
        assert run.supervisor.last_error is None
        assert len(paired) == 1
        # The bond holds.
        h10.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.connections == 2)
        count = len(run.sink.rows["ecg"])
        await until(run.sink.has(count + 73, "ecg"))
        assert len(paired) <= 2
    assert_only_gaps(h10, run)


async def test_pairing_may_come_first(sensor: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        raise AssertionError(f"{link.what} is paired already")

    monkeypatch.setattr(BleLink, "pair", pair)
    async with connected(h10, pair=True) as info:
        assert info.rates["ecg"] == 130


async def test_a_device_that_cannot_be_paired_is_a_matter_of_credentials(
    sensor: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    h10 = sensor(Quirks(demands_pairing=True))

    async def pair(link: BleLink) -> None:
        """Do as a system does that believes it is paired already."""

    monkeypatch.setattr(BleLink, "pair", pair)
    with pytest.raises(CredentialError, match="remove the sensor in the system's Bluetooth"):
        async with connected(h10):
            pass


@pytest.mark.parametrize("firmware", [Firmware.OLD, Firmware.HEART_RATE_ONLY])
async def test_without_a_pmd_service_it_is_a_heart_rate_strap(
    sensor: Twins, firmware: Firmware
) -> None:
    h10 = sensor(Quirks(firmware=firmware))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(3, "hr", "ibi", "quality"))
            h10.apply(Fault(FaultKind.DROP, 0.2))
            await until(lambda: run.supervisor.connections == 2)
            count = len(run.sink.rows["hr"])
            await until(run.sink.has(count + 1, "hr"))
    assert sum("update it with Polar Flow" in entry["event"] for entry in logs) == 1
    assert run.sink.rows["ecg"] == []


async def test_a_small_mtu_is_enough(world: World) -> None:
    radio = Radio(world, host_mtu=64)
    with virtual_bluetooth(radio), SimulatedPolarH10(world, radio) as h10:
        async with streaming(h10) as run:
            await until(run.sink.has(200, "ecg"))
            await until(run.sink.has(50, "acc"))
            assert run.sink.lost_count("ecg") == 0
        assert_only_gaps(h10, run)


async def test_an_mtu_that_is_too_small_for_all_is_an_error(sensor: Twins) -> None:
    h10 = sensor(Quirks(minimum_mtu=512))
    with pytest.raises(ProtocolError, match="ecg: INVALID_MTU") as caught:
        async with connected(h10):
            pass
    assert caught.value.reason is ProtocolReason.REFUSED


async def test_compressed_acceleration_is_the_same(sensor: Twins) -> None:
    h10 = sensor(Quirks(compressed_acceleration=True))
    async with streaming(h10) as run:
        await until(run.sink.has(150, "acc"))
        assert run.sink.lost_count("acc") == 0
    assert_only_gaps(h10, run)


async def test_a_verity_sense_delivers_what_it_has(sensor: Twins) -> None:
    verity = sensor(product=VERITY_SENSE)
    async with streaming(verity) as run:
        await until(run.sink.has(100, "acc"))
        await until(run.sink.has(3, "hr", "ibi", "quality"))
        assert run.supervisor.connections == 1
    assert_once_and_in_order(run.sink.rows["acc"], verity.truth.samples("acc").values)
    assert_once_and_in_order(run.sink.rows["ibi"], verity.truth.samples("ppi").values)
    assert run.sink.rows["ecg"] == []
    async with connected(verity) as info:
        assert info.rates == {"acc": 52}


async def test_the_device_is_left_still(sensor: Twins) -> None:
    """One that is left measuring empties its battery."""
    h10 = sensor(Quirks(keeps_streaming=True))
    async with streaming(h10) as run:
        await until(run.sink.has(100, "ecg"))
    sent = len(h10.truth.samples("ecg").times)
    async with connected(h10, ecg=False, acc=False):
        await asyncio.sleep(1.5)
        assert len(h10.truth.samples("ecg").times) == sent


async def test_an_error_while_connecting_is_one_of_the_known_ones(world: World) -> None:
    # Nothing is on this air, and soon not even the air.
    driver = DRIVER.make(settings(device="A1B2C3D4"), NotedSink())()
    radio = Radio(world)
    with virtual_bluetooth(radio):
        radio.available = False
        with pytest.raises(GatewayError):
            await driver.connect()
        await driver.close()


def test_limits() -> None:
    assert session_module.GOODBYE_LIMIT_S < 0.5


def test_settings_of_another_sensor_are_a_mistake() -> None:
    with pytest.raises(TypeError, match="Polar"):
        DRIVER.make(DeviceSettings(sensor="zephyr", unit="x"), NotedSink())
