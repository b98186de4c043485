"""The driver streams from virtual EmotiBits: all of it, once, at the right time."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotibit.driver import EmotiBitSettings, find
from biosensor_gateway.devices.emotibit.driver import link as link_module
from biosensor_gateway.devices.emotibit.driver.emitter import CHANNELS, EmotiBitEmitter
from biosensor_gateway.devices.emotibit.driver.link import Link
from biosensor_gateway.devices.emotibit.driver.protocol import Packet, read
from biosensor_gateway.devices.emotibit.simulator import rounds as wire
from biosensor_gateway.devices.emotibit.simulator.rounds import Rounds
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.ports import SYSTEM_PORTS
from biosensor_gateway.transports.tap import LinkTap
from tests.emotibit.conftest import packet
from tests.rigs.driver_run import connected, streaming
from tests.rigs.emitter_sink import EmitterSink
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
        (100.0, 25, "100 times per second, but its setting `ppg_rate` is 25; set `ppg_rate = 100`"),
        (25.0, 100, "25 times per second, but its setting `ppg_rate` is 100; set `ppg_rate = 25`"),
        (
            50.0,
            100,
            r"5\d times per second, .* `ppg_rate` is 100; install a firmware that has 25 or",
        ),
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
    with pytest.raises(ProtocolError, match="does a firewall on this computer block it"):
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


# The link to an EmotiBit, without one.

HERE = "127.0.0.1"
DATAGRAMS = 5
PAUSE_S, BUSY_S = 0.1, 2.0

# Only a real port is read while the loop is busy.


def sent_while_nothing_else_runs(data_port: int) -> list[float]:
    """Send some packets, one after another, and let the loop have no turn for a while."""
    times_s: list[float] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for number in range(DATAGRAMS):
            times_s.append(LSL_CLOCK())
            device.sendto(b"1,%d,1,HR,1,100,70\n" % number, (HERE, data_port))
            time.sleep(PAUSE_S)
    time.sleep(BUSY_S)
    return times_s


@pytest.mark.nightly
async def test_what_comes_while_the_agent_is_busy_has_the_time_of_its_arrival() -> None:
    link = Link("EmotiBit 1", HERE, SYSTEM_PORTS, LinkTap(LSL_CLOCK))
    await link.open()
    sent_s = sent_while_nothing_else_runs(int(link.data_payload[1]))
    arrived = [await link.read() for _ in sent_s]
    await link.close()
    assert [each.found.packets[0].number for each in arrived] == list(range(DATAGRAMS))
    for each, sent in zip(arrived, sent_s, strict=True):
        assert sent <= each.arrival_s < sent + BUSY_S


# A device that is less tidy: channels read one after another, datagrams that overtake others.

REAL = Path(__file__).parent / "vectors" / "real_channels_read_apart.csv"
LATE_S = 0.02
READ_HZ = 75


def parts(packets: Sequence[Packet], size: int) -> list[Sequence[Packet]]:
    """Return packets as datagrams of so many."""
    return [packets[at : at + size] for at in range(0, len(packets), size)]


def emitted(datagrams: Iterable[Sequence[Packet]], ppg_hz: float = 25) -> EmitterSink:
    """Return what is emitted of datagrams that come one after another."""
    sink = EmitterSink("emotibit")
    emitter = EmotiBitEmitter(sink, ppg_hz)
    emitter.connected()
    newest_ms = 0
    for packets in datagrams:
        newest_ms = max(newest_ms, *(each.time_ms for each in packets))
        emitter.take(packets, 1000 + newest_ms / 1000 + LATE_S)
    emitter.ended()
    return sink


CHANNEL_HZ: dict[str, float] = {
    **dict.fromkeys(("PI", "PR", "PG", "AX", "AY", "AZ"), 25.0),
    "EA": 15.0,
    "T1": 7.5,
}


_NO_OTHERS: Mapping[str, float] = MappingProxyType({})


def rounds(
    ppg_hz: float = 25,
    *,
    seconds: int = 60,
    apart_every: int = 10**9,
    apart: Sequence[str] = ("PG", "AZ"),
    more: bool = True,
    others: Mapping[str, float] = _NO_OTHERS,
) -> Iterator[list[Packet]]:
    """Measure numbers from 0 on; each value is its sample's number.

    Parameters
    ----------
    apart_every
        In which rounds the channels *apart* are read one look later than what belongs to them, or
        with a sample fewer.
    others
        Rates that are not the nominal ones.
    """
    channels = {**CHANNEL_HZ, **dict.fromkeys(("PI", "PR", "PG"), ppg_hz), **others}
    done = dict.fromkeys(channels, 0)
    number = 0
    for count in range(1, 10 * seconds):
        packets: list[Packet] = []
        for tag, hz in channels.items():
            is_apart = tag in apart and count % apart_every == 0
            until_s = count / 10 + is_apart * (1 / hz + 1 / READ_HZ if more else -1 / hz)
            upto = int(until_s * hz + 1e-9)
            values = range(done[tag], upto)
            done[tag] = upto
            read_ms = int(1000 * -(-upto / hz * READ_HZ // 1) / READ_HZ)
            if values:
                packets.append(packet(5000 + read_ms, number % 65536, tag, *values))
                number += 1
        yield packets


ROUNDS = {each: list(rounds(seconds=10, apart_every=each)) for each in (7, 10**9)}


def errors_s(
    sink: EmitterSink, name: str, hz: float
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return how far each stamp is from when the sample was measured, on the device's clock."""
    numbers = np.array(sink.values(name))
    return np.array(sink.device_times[name]) - 5 - (numbers + 1) / hz


def assert_whole(sink: EmitterSink, rates: dict[str, float], limit_s: float = 0.015) -> None:
    """Assert that samples came once, in order, whole, and stamped when they were measured."""
    assert not any(sink.losses.values())
    for name, hz in rates.items():
        numbers = sink.values(name)
        begin = int(numbers[0])
        assert numbers == list(range(begin, begin + len(numbers))), name
        assert all(len(set(row)) == 1 for row in sink.emitted[name]), name
        assert np.abs(errors_s(sink, name, hz)).max() < limit_s, name


def test_a_real_channel_that_was_read_later_makes_no_rows() -> None:
    packets = read(REAL.read_bytes()).packets
    sink = emitted(parts(packets, 19))
    assert not any(sink.losses.values())
    for name, tags in CHANNELS.items():
        sent = [
            [float(text) for each in packets if each.tag == tag for text in each.payload]
            for tag in tags
        ]
        assert sink.emitted[name] == [list(row) for row in zip(*sent, strict=True)]
        read_s = {
            sum(len(before.payload) for before in packets[: at + 1] if before.tag == tags[0]): (
                each.time_ms / 1000
            )
            for at, each in enumerate(packets)
            if each.tag == tags[0]
        }
        late_s = [sink.device_times[name][at - 1] - time_s for at, time_s in read_s.items()]
        assert np.ptp(late_s) < 0.03, name


@pytest.mark.parametrize("apart_every", [9, 70])
@pytest.mark.parametrize("ppg_hz", [25.0, 100.0])
def test_channels_that_are_read_apart_make_whole_rows(ppg_hz: float, apart_every: int) -> None:
    sink = emitted(rounds(ppg_hz, seconds=30, apart_every=apart_every), ppg_hz)
    assert_whole(sink, {"ppg": ppg_hz, "acc": 25, "eda": 15, "st": 7.5})


@pytest.mark.parametrize("tag", ["PI", "PR", "PG", "AX"])
@pytest.mark.parametrize("ppg_hz", [25.0, 100.0])
def test_a_channel_that_is_read_with_a_sample_fewer_makes_whole_rows(
    ppg_hz: float, tag: str
) -> None:
    made = rounds(ppg_hz, seconds=30, apart_every=7, apart=[tag], more=False)
    assert_whole(emitted(made, ppg_hz), {"ppg": ppg_hz, "acc": 25})


def test_a_channel_that_lost_a_sample_is_beside_the_others_again() -> None:
    made = [
        [each if each.tag != "PR" or at != 99 else each._replace(payload=each.payload[1:])
         for each in packets]
        for at, packets in enumerate(rounds(100.0, seconds=30))
    ]  # fmt: skip
    sink = emitted(made, 100.0)
    apart = [len(set(row)) > 1 for row in sink.emitted["ppg"]]
    assert 0 < sum(apart) < 60
    assert not any(apart[-1500:])
    assert not any(sink.losses.values())


@given(
    seed=st.integers(0, 10**6), share=st.floats(0.01, 0.2), pieces=st.integers(1, 3),
    behind=st.integers(1, 3), apart_every=st.sampled_from(list(ROUNDS)),
)  # fmt: skip
def test_datagrams_that_overtook_others_change_nothing(
    seed: int, share: float, pieces: int, behind: int, apart_every: int
) -> None:
    chance = random.Random(seed)
    sent = [part for made in ROUNDS[apart_every] for part in parts(made, -(-len(made) // pieces))]
    # What the first ones of a connection overtook is before its beginning.
    late = [at >= 3 * pieces and chance.random() < share for at in range(len(sent))]
    places = [at + (behind + 0.5) * is_late for at, is_late in enumerate(late)]
    came = [sent[at] for at in sorted(range(len(sent)), key=lambda at: places[at])]
    copies = [each for made in came for each in [made] * (1 + (chance.random() < share))]
    assert_whole(emitted(copies), {"ppg": 25, "acc": 25, "eda": 15, "st": 7.5})


@given(seed=st.integers(0, 10**6), apart_every=st.sampled_from(list(ROUNDS)))
def test_lost_datagrams_are_counted_among_channels_read_apart(seed: int, apart_every: int) -> None:
    chance = random.Random(seed)
    sent = ROUNDS[apart_every]
    came = [each for each in sent if chance.random() > 0.05]
    sink = emitted([sent[0], *came[1:-1], sent[-1]])
    for name, hz in {"acc": 25.0, "eda": 15.0}.items():
        whole = [row for row in sink.emitted[name] if len(set(row)) == 1]
        last = int(max(row[0] for row in whole))
        missing = last + 1 - len(sink.emitted[name])
        assert sink.losses.get(name, 0) == pytest.approx(missing, abs=1)
        assert np.abs(errors_s(sink, name, hz)[~np.isnan(sink.values(name))]).max() < 1 / hz


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("eda", {"EA": 30.0}),
        ("eda", {"EA": 14.0}),
        ("st", {"T1": 3.75}),
        ("acc", dict.fromkeys(("AX", "AY", "AZ"), 50.0)),
        ("acc", dict.fromkeys(("AX", "AY", "AZ"), 26.0)),
    ],
)
def test_a_sensor_of_another_rate_is_said_and_stamped_by_that(
    name: str, others: dict[str, float]
) -> None:
    sink = emitted(rounds(seconds=30, others=others))
    hz = min(others.values())
    assert f"{name} is measured {hz:.1f} times per second" in " ".join(sink.watch.remarks.values())
    assert len(sink.watch.remarks) == 1
    assert not any(sink.losses.values())
    assert np.abs(errors_s(sink, name, hz)[round(12 * hz) :]).max() < 0.02
    assert np.diff(sink.device_times[name]).min() > 0


def test_the_first_temperatures_are_not_lost_while_thermometers_are_looked_for() -> None:
    sink = emitted(rounds(seconds=10))
    assert sink.values("st")[:3] == [0, 1, 2]


@pytest.mark.parametrize("offset_s", [0.02, 0.045, 0.06])
def test_behind_a_break_the_samples_are_where_they_were_read(offset_s: float) -> None:
    """A device may measure again behind it, between the times that it measured at before."""
    sink = EmitterSink("emotibit")
    emitter = EmotiBitEmitter(sink, 25)
    made = list(rounds(seconds=30))
    for number, packets in enumerate(made):
        at_ms = 0 if number < 200 else round(2000 + 1000 * offset_s)
        if number in (0, 200):
            emitter.connected()
        moved = [each._replace(time_ms=each.time_ms + at_ms) for each in packets]
        emitter.take(moved, 1000 + max(each.time_ms for each in moved) / 1000 + LATE_S)
    for name, hz in {"eda": 15.0, "st": 7.5}.items():
        errors = errors_s(sink, name, hz)
        numbers = np.array(sink.values(name))
        behind = numbers * 10 / hz >= 201 + 10
        assert np.abs(errors[behind] - 2 - offset_s).max() < 0.02, name
