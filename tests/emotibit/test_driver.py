"""The driver streams from virtual EmotiBits: all of it, once, at the right time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotibit.driver import EmotiBitSettings, find
from biosensor_gateway.devices.emotibit.driver import link as link_module
from biosensor_gateway.devices.emotibit.simulator import rounds as wire
from biosensor_gateway.devices.emotibit.simulator.rounds import Rounds
from biosensor_gateway.simulation.faults import Fault, FaultKind
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.emotibit.conftest import MakeEmotiBit

REGULAR = ("eda", "ppg", "acc", "gyro", "mag")


async def test_the_firmware_with_a_fast_pulse_is_read(emotibit: MakeEmotiBit) -> None:
    device = emotibit(ppg_hz=100.0)
    async with streaming(device, ppg_rate=100) as run:
        await until(run.sink.has(150, "ppg"))
        assert run.sink.rates["ppg"] == 100
    assert_once_and_in_order(run.sink.rows["ppg"], device.truth.samples("ppg").values)


@pytest.mark.parametrize(
    ("ppg_hz", "ppg_rate", "sentence"),
    [
        (100.0, 25, "100 times a second, and its setting `ppg_rate` is 25; set `ppg_rate = 100`"),
        (25.0, 100, "25 times a second, and its setting `ppg_rate` is 100; set `ppg_rate = 25`"),
        (50.0, 100, r"5\d times a second, .* `ppg_rate` is 100; install a firmware that has 25 or"),
    ],
)
async def test_another_rate_of_the_pulse_is_refused(
    emotibit: MakeEmotiBit, ppg_hz: float, ppg_rate: int, sentence: str
) -> None:
    device = emotibit(ppg_hz=ppg_hz)
    with pytest.raises(ProtocolError, match=sentence) as caught:
        async with connected(device, ppg_rate=ppg_rate):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


async def test_datagrams_that_are_lost_are_counted(emotibit: MakeEmotiBit) -> None:
    device = emotibit()
    async with streaming(device) as run:
        await until(run.sink.has(20, *REGULAR))
        device.lose(12)
        await run.goes_on(30, *REGULAR)
        assert run.lost.keys() >= {"eda", "acc", "gyro"}
    # While it streams, what has just arrived may not be noted as sent yet.
    for name in REGULAR:
        came = [row for row in run.sink.rows[name] if not np.isnan(row).any()]
        places = assert_once_and_in_order(came, device.truth.samples(name).values)
        assert places[0] == 0


async def test_the_time_is_told_when_the_device_asks(
    emotibit: MakeEmotiBit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("biosensor_gateway.devices.emotibit.simulator.rounds.SYNC_EVERY_ROUNDS", 5)
    noted: list[tuple[str, list[str]]] = []
    note = Rounds.note

    def noting(rounds: Rounds, tag: str, payload: list[str]) -> bytes:
        noted.append((tag, payload))
        return note(rounds, tag, payload)

    monkeypatch.setattr(Rounds, "note", noting)
    async with streaming(emotibit()):
        await until(lambda: len(noted) >= 3)
    (local, (local_time,)), (utc, (utc_time,)), (acknowledged, payload) = noted[:3]
    assert (local, utc, acknowledged) == (wire.TIME_LOCAL, wire.TIME_UTC, wire.ACKNOWLEDGED)
    for told in (local_time, utc_time):
        day, clock = told.split("_")
        assert [len(part) for part in (*day.split("-"), *clock.split("-"))] == [4, 2, 2, 2, 2, 2, 6]
    assert payload[0].isdigit() and payload[1] == wire.REQUEST


async def test_who_is_used_by_another_host_says_so(
    emotibit: MakeEmotiBit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "CONNECT_LIMIT_S", 0.2)
    device = emotibit()
    device.apply(Fault(FaultKind.REFUSE, 3600.0))
    with pytest.raises(TransportError, match="another program or computer uses it") as caught:
        async with connected(device):
            pass
    assert caught.value.reason is TransportReason.BUSY


async def test_a_device_that_cannot_reach_this_computer_is_told(
    emotibit: MakeEmotiBit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "CONNECT_LIMIT_S", 0.2)
    monkeypatch.setattr("biosensor_gateway.devices.emotibit.simulator.rounds.CONNECT", "??")
    with pytest.raises(ProtocolError, match="does a firewall of this computer refuse it"):
        async with connected(emotibit()):
            pass


async def test_the_one_that_is_wanted_is_chosen(emotibit: MakeEmotiBit) -> None:
    device = emotibit()
    async with connected(device, device="md-v5-0000123") as told:
        assert told.info.serial_number == "MD-V5-0000123"
    with pytest.raises(TransportError, match=r"no EmotiBit X-1 answers at .*; there are MD-V5"):
        async with connected(device, device="X-1"):
            pass


async def test_those_in_the_network_are_found_with_their_settings(
    emotibit: MakeEmotiBit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("biosensor_gateway.devices.emotibit.driver._LISTEN_S", 0.7)
    device = emotibit()
    port = device.settings["port"]
    monkeypatch.setattr("biosensor_gateway.devices.emotibit.driver.ADVERTISING_PORT", port)
    (found,) = await find([])
    assert found.settings == {"unit": "MD-V5-0000123", "device": "MD-V5-0000123"}
    own = EmotiBitSettings(sensor="emotibit", unit="1", host="127.0.0.1", port=port)
    (found,) = await find([own])
    assert found.settings["host"] == "127.0.0.1"
