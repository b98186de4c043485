"""The driver streams from virtual headbands: all of it, once, at the right time."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent.state import State
from biosensor_gateway.devices.muse.driver.protocol import EEG, FRAMES
from biosensor_gateway.devices.muse.simulator import SimulatedAthena, SimulatedMuse
from biosensor_gateway.simulation.faults import Fault, FaultKind, Untidiness
from biosensor_gateway.transports.ble import BleLink
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.muse.conftest import Make

SECONDS = 24.0
PATIENCE_S = 15.0
LIGHT = {SimulatedMuse: "ppg", SimulatedAthena: "optics"}
CLASSIC = pytest.mark.parametrize("kind", [SimulatedMuse], ids=["classic"])
ATHENA = pytest.mark.parametrize("kind", [SimulatedAthena], ids=["athena"])


def assert_complete(run: Run, device: SimulatedMuse | SimulatedAthena, *names: str) -> None:
    """Assert that all samples came from the first one on, and that nothing was lost."""
    for name in names:
        places = assert_once_and_in_order(run.sink.rows[name], device.truth.samples(name).values)
        assert places == list(range(len(places))), name
    assert run.sink.dropped_bytes == 0


async def test_every_stream_fills_with_what_the_headband_sent(headband: Make) -> None:
    device = headband(rssi_dbm=-49)
    light = LIGHT[type(device)]
    async with streaming(device, aux=True) as run:
        await until(run.sink.has(300, "eeg", "aux"))
        await until(run.sink.has(60, light, "acc", "gyro"))
        await until(run.sink.has(1, "bat"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        lost = {run.sink.lost_count(name) for name in ("eeg", "aux", light, "acc", "gyro")}
    assert_complete(run, device, "eeg", "aux", light, "acc", "gyro")
    assert lost == {0}
    assert run.sink.rows["rssi"] == [[-49]]
    assert run.sink.rows["bat"][0] == [87]


@pytest.mark.parametrize("jitter_s", [0.0, 0.03, 0.1])
@ON_BUMBLE
async def test_samples_are_stamped_when_they_were_measured(headband: Make, jitter_s: float) -> None:
    device = headband(drift_ppm=100, jitter_s=jitter_s)
    light = LIGHT[type(device)]
    async with streaming(device) as run:
        await asyncio.sleep(SECONDS)
    for name in ("eeg", light, "acc", "gyro"):
        stamps = np.array(run.sink.times[name])
        errors = stamps - device.truth.samples(name).times[: len(stamps)]
        settled = errors[len(errors) // 4 :]
        assert np.abs(settled).max() < 0.02, name
        assert all(a < b for a, b in pairwise(stamps))
        assert np.sqrt(np.mean(np.square(np.diff(settled)))) < 1e-3


@CLASSIC
@ON_BUMBLE
async def test_a_movement_sensor_with_an_oscillator_of_its_own_is_followed(headband: Make) -> None:
    device = headband(motion_deviation=0.01, jitter_s=0.03)
    async with streaming(device) as run:
        await asyncio.sleep(2 * SECONDS)
    stamps = np.array(run.sink.times["acc"])
    errors = (stamps - device.truth.samples("acc").times[: len(stamps)])[len(stamps) // 2 :]
    assert np.abs(errors).max() < 0.02


@pytest.mark.parametrize(
    ("optics", "aux", "columns"), [(0, False, 0), (4, False, 4), (8, True, 8), (16, True, 16)]
)
@ATHENA
@ON_BUMBLE
async def test_light_has_the_channels_of_the_settings(
    headband: Make, optics: int, aux: bool, columns: int
) -> None:
    device = headband()
    async with streaming(device, optics=optics, aux=aux) as run:
        await until(run.sink.has(200, "eeg", *(["aux"] if aux else [])))
        await until(run.sink.has(60, "acc", *(["optics"] if optics else [])))
    assert_complete(run, device, "eeg", "acc", *(["optics"] if optics else []))
    filled = ~np.isnan(np.array(run.sink.rows["optics"] or [[]])).all(axis=0)
    assert filled.sum() == columns
    assert bool(run.sink.rows["aux"]) == aux


@CLASSIC
@ON_BUMBLE
async def test_what_is_switched_off_is_not_sent(headband: Make) -> None:
    device = headband()
    async with streaming(device, ppg=False) as run:
        await until(run.sink.has(200, "eeg"))
    assert not run.sink.rows["ppg"]
    async with connected(device, ppg=False) as info:
        assert (info.silent, info.refused) == ({"aux", "ppg", "optics"}, {"optics"})


async def test_it_is_known_by_what_it_says_of_itself(headband: Make) -> None:
    device = headband()
    is_athena = isinstance(device, SimulatedAthena)
    async with connected(device) as info:
        assert info.info.model == ("Muse S Athena" if is_athena else "Muse 2")
        assert info.info.serial_number == ("7001-FA20-0001" if is_athena else "4021-3A1F-0001")
        assert info.info.firmware_version == "1.2.13"
        assert info.silent == {"aux"} | info.refused
        assert info.refused == ({"ppg"} if is_athena else {"optics"})


@pytest.mark.parametrize(
    ("kind", "preset"),
    [(SimulatedMuse, "p1041"), (SimulatedAthena, "p50")],
    ids=["classic", "athena"],
)
@ON_BUMBLE
async def test_a_preset_of_another_model_is_said(headband: Make, preset: str) -> None:
    with pytest.raises(ProtocolError, match=f"no preset {preset}") as caught:
        async with connected(headband(), preset=preset):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@CLASSIC
@ON_BUMBLE
async def test_a_preset_of_the_settings_is_taken(headband: Make) -> None:
    async with connected(headband(), preset="p20", aux=True) as info:
        assert info.silent == {"ppg", "optics"}


@ON_BUMBLE
async def test_who_refuses_everything_says_so(headband: Make) -> None:
    device = headband()
    device.apply(Fault(FaultKind.REFUSE, 3600.0))
    with pytest.raises(ProtocolError, match="refuses the command v") as caught:
        async with connected(device):
            pass
    assert caught.value.reason is ProtocolReason.REFUSED


@CLASSIC
@ON_BUMBLE
async def test_a_headband_of_an_unknown_generation_is_said(
    headband: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    has = BleLink.has

    def without_data(link: BleLink, uuid: str) -> bool:
        return uuid not in (*EEG, *FRAMES) and has(link, uuid)

    monkeypatch.setattr(BleLink, "has", without_data)
    with pytest.raises(ProtocolError, match="hold its button for 30 s") as caught:
        async with connected(headband()):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@ON_BUMBLE
async def test_answers_that_share_a_packet_are_heard(headband: Make) -> None:
    device = headband()
    device.apply(Fault(Untidiness.GLUED, 3600.0))
    async with streaming(device) as run:
        await until(run.sink.has(200, "eeg"))
        assert run.supervisor.connections == 1
    assert_complete(run, device, "eeg")


@pytest.mark.parametrize("wanted", ["00:55:da:b0:77:01", ""])
@ON_BUMBLE
async def test_a_headband_without_a_name_is_found(headband: Make, wanted: str) -> None:
    device = headband(address="00:55:DA:B0:77:01")
    device.apply(Fault(Untidiness.NAMELESS, 3600.0))
    async with connected(device, device=wanted) as found:
        assert found.info.serial_number


@ON_BUMBLE
async def test_a_full_battery_is_told_as_full(headband: Make) -> None:
    device = headband()
    device.apply(Fault(FaultKind.LOW_BATTERY, 100.0))
    async with streaming(device) as run:
        await until(run.sink.has(1, "bat"))
    assert run.sink.rows["bat"][0] == [100]


@ON_BUMBLE
async def test_it_is_kept_alive(headband: Make) -> None:
    device = headband(patience_s=PATIENCE_S)
    async with streaming(device) as run:
        await asyncio.sleep(3 * PATIENCE_S)
        await run.goes_on(100, "eeg")
        assert run.supervisor.connections == 1


@ON_BUMBLE
async def test_what_a_gap_cost_is_counted_when_the_headband_stayed_on(headband: Make) -> None:
    device = headband()
    async with streaming(device) as run:
        await until(run.sink.has(1000, "eeg"))
        device.apply(Fault(FaultKind.DROP, 3.0))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(200, "eeg")
        gap_s = float(np.diff(np.array(run.sink.times["eeg"])).max())
        assert run.sink.lost_count("eeg") == pytest.approx(256 * gap_s - 1, abs=48)


@ATHENA
@ON_BUMBLE
async def test_an_athena_that_was_restarted_counts_again_and_nothing_is_lost_for_it(
    headband: Make,
) -> None:
    device = headband()
    with capture_logs() as logs:
        async with streaming(device) as run:
            await until(run.sink.has(1000, "eeg"))
            device.apply(Fault(FaultKind.RESTART, 3.0))
            await until(lambda: run.supervisor.connections == 2)
            await run.goes_on(200, "eeg")
            assert run.sink.lost_count("eeg") == 0
    assert "the device was switched off and counts again" in {entry["event"] for entry in logs}
    assert np.all(np.diff(run.sink.times["eeg"]) > 0)


@ON_BUMBLE
async def test_what_was_lost_within_a_connection_is_counted_exactly(headband: Make) -> None:
    device = headband()
    light = LIGHT[type(device)]
    async with streaming(device) as run:
        await until(run.sink.has(300, "eeg"))
        device.apply(Fault(FaultKind.STALL, 1.0))
        await run.goes_on(1000, "eeg")
        await run.goes_on(100, "acc", light)
        assert run.supervisor.connections == 1
        for name in ("eeg", "acc", "gyro", light):
            lost = run.sink.lost_count(name)
            assert lost == device.truth.unsent_count(name), name
            assert lost > 0
