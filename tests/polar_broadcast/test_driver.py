"""The driver on the virtual air, besides what holds for any."""

from __future__ import annotations

import asyncio
import json
import math
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_broadcast import driver as emitter_module
from biosensor_gateway.devices.polar_broadcast.driver import BroadcastEmitter, identify, recognise
from biosensor_gateway.devices.polar_broadcast.driver.protocol import COUNTS, parse
from biosensor_gateway.devices.polar_broadcast.simulator import SimulatedPolarBroadcast
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio, Transceiver
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, connected, streaming
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.polling import until

HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"
RATE = {0x006B: bytes.fromhex("3b1b5452")}


@ON_BUMBLE
async def test_it_is_heard_with_its_name_and_at_its_time(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio, device_id="CAFE0001") as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(8, "hr", "hr_fast"))
        assert (run.sink.info.model, run.sink.info.serial_number) == ("H9", "CAFE0001")
        assert set(run.sink.values("rssi")) == {-66}
        truth = strap.truth.samples("hr")
        late_s = [
            min(heard_s - measured_s for measured_s in truth.times if measured_s <= heard_s)
            for heard_s in run.sink.times["hr"]
        ]
        assert max(late_s) < 0.1
        assert run.sink.losses == {}


async def test_a_strap_that_is_connected_to_is_listened_to_as_well(radio: Radio) -> None:
    """Whoever only listens neither takes the device for himself nor frees it for himself."""
    with (
        SimulatedPolarBroadcast(radio.world, radio) as strap,
        SimulatedPolarH10(radio.world, radio) as h10,
    ):
        async with streaming(strap) as heard, streaming(h10) as linked:
            await until(heard.sink.has(3, "hr"))
            await until(linked.sink.has(3, "hr"))
            assert linked.supervisor.connections == 1


async def test_a_counter_that_stands_is_a_reason(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(3, "hr"))
            strap.apply(Fault(FaultKind.STALL, 60.0))
            await until(lambda: run.supervisor.state is not State.STREAMING)
            assert "no data of hr" in run.error
            count = len(run.sink.rows["hr"])
            strap.clear(FaultKind.STALL)
            await until(run.is_streaming)
            assert len(run.sink.rows["hr"]) > count - 1


@ON_BUMBLE
async def test_who_goes_out_of_range_is_looked_for_and_what_was_missed_is_counted(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(5, "hr"))
            strap.apply(Fault(FaultKind.DROP, 20.0))
            await until(lambda: "can no longer be heard" in run.error)
            await run.goes_on(3, "hr")
        assert run.supervisor.connections == 2
        assert run.sink.lost_count("hr") == strap.truth.unsent_count("hr")


async def test_a_device_that_tells_no_rate_is_said_to_tell_none(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        strap.apply(Fault(FaultKind.UNREADABLE, 60.0))
        # What was advertised before is over.
        await asyncio.sleep(2.0)
        with pytest.raises(ProtocolError, match="contain no heart rate") as caught:
            async with connected(strap):
                pass
        assert caught.value.reason is ProtocolReason.UNSUPPORTED


def test_it_is_found_with_the_settings_that_lead_to_it() -> None:
    found = recognise(
        Advertisement("A0:9E:1A:00:00:01", "Polar H7 7D4940C1", -60, frozenset(), RATE)
    )
    assert found is not None
    assert found.settings == {"unit": "7D4940C1", "device": "7D4940C1"}
    nameless = Advertisement("A0:9E:1A:00:00:01", manufacturer_data=RATE)
    assert identify(nameless) == nameless.address
    assert recognise(Advertisement("A0:9E:1A:00:00:01", "Polar 360 7D4940C1")) is None
    assert recognise(SerialPort("COM7")) is None


@pytest.mark.parametrize(
    ("model", "services", "sensor"),
    [
        ("H10", frozenset({HEART_RATE}), "polar_h10"),
        ("H9", frozenset({HEART_RATE}), "ble_heart_rate"),
        ("H9", frozenset[str](), "polar_broadcast"),
        ("Vantage M", frozenset[str](), "polar_broadcast"),
    ],
)
def test_scan_offers_a_connection_where_there_is_one(
    model: str, services: frozenset[str], sensor: str
) -> None:
    seen = Advertisement("A0:9E:1A:00:00:01", f"Polar {model} A1B2C3D4", -60, services, RATE)
    found = recognised(drivers_by_precedence(), seen)
    assert found is not None
    assert found.sensor == sensor


# Advertised heart rates, against vectors and any bytes, and which samples they become.

# Advertised heart rates, against vectors and against any bytes.

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "advertisements.json").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    broadcast = parse(bytes.fromhex(vector["hex"]))
    assert broadcast is not None
    assert broadcast._asdict() == vector["expected"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "33",
        "3300",
        # Longer than any that is known.
        "3300003838",
        # Nothing but blocks of other kinds, the last one cut short.
        "7208" + 8 * "00",
        "7208" + 3 * "00",
        "72",
        "720072",
    ],
)
def test_where_no_heart_rate_is_there_is_none(text: str) -> None:
    assert parse(bytes.fromhex(text)) is None


@given(st.binary(max_size=31))
def test_any_bytes_are_a_possible_rate_or_none(data: bytes) -> None:
    broadcast = parse(data)
    if broadcast is not None:
        assert 0 <= broadcast.counter < COUNTS
        assert broadcast.bpm in data
        assert len(data) >= 3


STRAPS = 100
INTERVAL_MS = 250.0
MISSED = 0.3
SECONDS = 16.0
OLD_S = 2.0
FRESH = 0.99


def ages_s(strap: SimulatedPolarBroadcast, run: Run, until_s: float) -> np.ndarray:
    """Return how old the newest rate is, at each of many moments from the third one on."""
    arrivals = np.array(run.sink.times["hr"])
    measured = strap.truth.samples("hr").times
    # What is advertised at any moment is what was measured last.
    of_arrivals = measured[np.searchsorted(measured, arrivals, side="right") - 1]
    moments = np.arange(arrivals[2], until_s, 0.05)
    return moments - of_arrivals[np.searchsorted(arrivals, moments, side="right") - 1]


@ON_BUMBLE
async def test_of_a_hundred_straps_the_rate_is_hardly_ever_older_than_two_seconds(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    chance = Random(1)
    hear = Transceiver.on_advertising_pdu

    def hear_most(transceiver: Transceiver, pdu: object) -> None:
        if chance.random() >= MISSED:
            hear(transceiver, pdu)  # pyright: ignore[reportArgumentType] - as it comes

    monkeypatch.setattr(Transceiver, "on_advertising_pdu", hear_most)
    straps = [
        SimulatedPolarBroadcast(
            radio.world,
            radio,
            address=f"A0:9E:1A:00:00:{number:02X}",
            device_id=f"C1A550{number:02X}",
            interval_ms=INTERVAL_MS,
            seed=number,
        )
        for number in range(STRAPS)
    ]
    async with AsyncExitStack() as runs:
        with ExitStack() as worn:
            for strap in straps:
                worn.enter_context(strap)
            all_runs = [await runs.enter_async_context(streaming(strap)) for strap in straps]
            # In the world's time.
            await asyncio.sleep(SECONDS)
            until_s = radio.world.clock()
    ages = np.concatenate(
        [ages_s(strap, run, until_s) for strap, run in zip(straps, all_runs, strict=True)]
    )
    assert np.mean(ages <= OLD_S) >= FRESH, (
        f"{np.mean(ages <= OLD_S):.2%}, oldest {ages.max():.1f} s"
    )
    for strap, run in zip(straps, all_runs, strict=True):
        assert run.supervisor.connections == 1
        measured = strap.truth.samples("hr").times
        first_s, last_s = run.sink.times["hr"][0], run.sink.times["hr"][-1]
        # The one that was heard first was measured just before.
        count = np.count_nonzero((measured > first_s) & (measured <= last_s)) + 1
        assert len(run.sink.rows["hr"]) + run.sink.lost_count("hr") == count


# What becomes a sample, and what is counted as lost.
OK, SKIN = 1, 2


class Ether:
    """A device that is heard when a test says so, on a clock of its own."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.sink = EmitterSink("polar_broadcast")
        self.emitter = BroadcastEmitter(self.sink)

    def hear(
        self, counter: int, bpm: int = 70, *, after_s: float = 1.0, flags: int = OK | SKIN
    ) -> None:
        self.now_s += after_s
        data = bytes((flags | counter % 8 << 2, 0, bpm, bpm))
        self.emitter.heard(data, self.now_s, -60)

    def hear_short(self, bpm: int, *, after_s: float = 1.0) -> None:
        self.now_s += after_s
        self.emitter.heard(bytes((OK | SKIN, 0, bpm)), self.now_s, None)


@pytest.fixture
def ether() -> Ether:
    return Ether()


def test_what_is_advertised_again_is_emitted_once_with_its_first_arrival(ether: Ether) -> None:
    for counter in range(20):
        ether.hear(counter, 60 + counter, after_s=0.4)
        ether.hear(counter, 60 + counter, after_s=0.3)
        ether.hear(counter, 60 + counter, after_s=0.3)
    assert ether.sink.values("hr") == [60 + each for each in range(20)]
    assert ether.sink.times["hr"] == pytest.approx([1000.4 + each for each in range(20)])
    assert ether.sink.losses == {}


@pytest.mark.parametrize("missed", [1, 3, 6, 7, 8, 15, 23, 50])
def test_measurements_that_were_not_heard_are_counted(ether: Ether, missed: int) -> None:
    ether.hear(7)
    ether.hear(0)
    ether.hear(missed + 1, after_s=missed + 1.3)
    ether.hear(missed + 2)
    assert len(ether.sink.values("hr")) == 4
    assert ether.sink.losses == {"hr": missed, "hr_fast": missed, "quality": missed}


def test_what_was_missed_before_the_first_value_is_not_counted_of_it(ether: Ether) -> None:
    ether.hear(6, 0)
    ether.hear(7, 0)
    ether.hear(2, after_s=3.0)
    assert ether.sink.losses == {"quality": 2}


def test_copies_in_between_tell_how_many_turns_the_counter_made(ether: Ether) -> None:
    ether.hear(0)
    for _ in range(20):
        ether.hear(0, after_s=1.0)
    assert len(ether.sink.values("hr")) == 1
    ether.hear(1)
    assert ether.sink.losses == {}


def test_after_a_long_absence_nothing_is_counted_and_that_is_said(
    ether: Ether, capsys: pytest.CaptureFixture[str]
) -> None:
    ether.hear(0)
    ether.hear(5, after_s=emitter_module.COUNTABLE_S + 1)
    assert len(ether.sink.values("hr")) == 2
    assert ether.sink.losses == {}
    assert "is not counted as lost" in capsys.readouterr().out


def test_off_the_skin_the_rate_that_stays_is_not_sent(ether: Ether) -> None:
    ether.hear(0)
    ether.hear(1, flags=OK)
    ether.hear(2, flags=OK)
    assert ether.sink.values("hr") == [70]
    assert ether.sink.emitted["quality"] == [[1, 1], [0, 1], [0, 1]]


def test_what_an_optical_sensor_says_of_the_skin_means_nothing(ether: Ether) -> None:
    ether.emitter.feels_skin = False
    ether.hear(0, flags=OK)
    assert ether.sink.values("hr") == [70]
    [[contact, battery_ok]] = ether.sink.emitted["quality"]
    assert math.isnan(contact)
    assert battery_ok == 1
    assert ether.sink.lacking == {"quality": ["contact"]}


def test_no_reading_is_no_sample(ether: Ether) -> None:
    ether.hear(0, 0)
    assert ether.sink.values("hr") == []
    assert ether.sink.emitted["quality"] == [[1, 1]]


def test_a_battery_that_is_low_is_told_once(
    ether: Ether, capsys: pytest.CaptureFixture[str]
) -> None:
    ether.hear(0)
    for counter in range(1, 4):
        ether.hear(counter, flags=SKIN)
    assert [row[1] for row in ether.sink.emitted["quality"]] == [1, 0, 0, 0]
    assert capsys.readouterr().out.count("battery") == 1


def test_of_a_device_that_does_not_count_each_change_is_news(ether: Ether) -> None:
    for bpm in (70, 70, 71, 71, 71, 70):
        ether.hear_short(bpm, after_s=6.0)
    assert ether.sink.values("hr") == [70, 71, 70]
    assert ether.sink.losses == {}


def test_what_cannot_be_read_is_counted_once(ether: Ether) -> None:
    for data in (b"\x33", b"\x33", b"\x33\x00"):
        ether.emitter.heard(data, 1000.0, -60)
    assert ether.sink.dropped_bytes == 3
    assert ether.sink.values("quality") == []
