"""The virtual BioHarness 3: its truth against the wire, its sources, and every fault."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from datetime import date
from math import ceil
from pathlib import Path

import pytest

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.driver import DRIVER, ZephyrSettings
from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Message,
    RrIntervals,
    Summary,
    Waveform,
)
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator import RecordedZephyr, recorded_bioharness
from biosensor_gateway.devices.zephyr.simulator.recorded_bioharness import (
    RECORDING_150_S,
    RECORDING_WITH_GAP,
    Arrival,
    RecordedSource,
    read_timing,
    split,
)
from biosensor_gateway.devices.zephyr.simulator.wire import (
    REQUESTS,
    DeviceStamp,
    Packet,
    frame,
    response,
    waveform,
)
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.transports.byte_links import TcpLink
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.polling import eventually
from tests.rigs.zephyr import SteeredBioHarness

# The virtual BioHarness 3: its truth against the wire, and every fault.


# The virtual BioHarness's two sources, asked without a port, on a clock that is set.
ALL = frozenset(REQUESTS.values())
MONDAY = DeviceStamp(date(2026, 3, 2), 86_390_000)


@pytest.mark.parametrize("name", [RECORDING_150_S, RECORDING_WITH_GAP])
def test_a_recording_is_cut_without_losing_a_byte(name: str) -> None:
    source = RecordedSource.shipped(name)
    played = [*source.poll(0.0, ALL), *source.poll(1e6, ALL)]
    assert (
        sum(out.packet is not None for out in played)
        == {
            RECORDING_150_S: 1479,
            RECORDING_WITH_GAP: 1157,
        }[name]
        - 5
    )
    items = list(split(b"".join(out.data for out in played)))
    assert [item.data for item in items] == [out.data for out in played]


def test_a_frame_is_played_when_the_read_that_completed_it_arrived() -> None:
    first, second = (waveform(Packet.ECG, k, MONDAY, [512] * 63) for k in (0, 1))
    data = first + response(0x16, accepted=True) + second
    reads = read_timing("50.0,10\n50.5,93\n51.0,150\n52.0,191\n")
    assert reads[1] == Arrival(50.5, 93)
    source = RecordedSource(data, reads, speed=2.0)
    enabled = frozenset({Packet.ECG})
    played = [[out.data for out in source.poll(now, enabled)] for now in (7.0, 7.74, 7.76)]
    assert played == [[first], [], [second]]


def test_without_reads_a_frame_is_played_when_its_samples_are_complete() -> None:
    breathing = waveform(Packet.BREATHING, 0, MONDAY, [512] * 18)
    ecg = waveform(Packet.ECG, 0, MONDAY.plus(1500), [512] * 63)
    source = RecordedSource(breathing + frame(Packet.LIFESIGN) + b"junk" + ecg)
    enabled = frozenset({Packet.ECG, Packet.BREATHING})
    assert len(source.poll(0.0, enabled)) == 3
    assert source.poll(0.74, enabled) == []
    assert [out.data for out in source.poll(0.745, enabled)] == [ecg]


# The virtual BioHarness's encoders against bytes of real devices and the layout.


# The virtual BioHarness on TCP, as where there are no pseudo-terminals.


@pytest.fixture
def device() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness(SyntheticSource(seed=2), tcp=True) as running:
        yield running


def _pushed(sink: DeviceSink) -> int:
    return next((c.pushed for name, c in sink.counters.items() if name.endswith("ecg")), 0)


async def test_a_driver_streams_and_comes_back_after_a_hang_up(
    device: SteeredBioHarness,
) -> None:
    settings = ZephyrSettings(sensor="zephyr", unit="TCP", port=device.port)
    sink = DeviceSink(DeviceIdentity("zephyr", "TCP"), declaration("zephyr"))
    supervisor = Supervisor(DRIVER.make(settings, sink), sink)
    task = asyncio.create_task(supervisor.run())
    try:
        await eventually(lambda: _pushed(sink) > 200)
        await asyncio.to_thread(device.drop_link, 0.5)
        await eventually(lambda: supervisor.connections == 2)
        before = _pushed(sink)
        await eventually(lambda: _pushed(sink) > before + 200)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        sink.close()


async def test_while_it_hangs_up_connections_are_refused(device: SteeredBioHarness) -> None:
    await asyncio.to_thread(device.drop_link)
    host, _, port = device.port.removeprefix("socket://").partition(":")
    link = TcpLink(host, int(port))
    with pytest.raises(TransportError) as refused:
        await link.open()
    await link.close()
    assert refused.value.reason is TransportReason.ABSENT


# What the driver makes of the shipped recording, as it is and with its numbers spoilt.

FOLDER = Path(recorded_bioharness.__file__).parent / "recordings"
NAME = "zephyr_bh3_2012-09-26_150s"
NUMBERS = {"hr": "heart_rate_bpm", "hrv": "hrv_ms", "st": "skin_temperature_c"}

Periodic = Waveform | Acceleration | RrIntervals | Summary


def messages() -> Iterator[tuple[float, Message]]:
    """Yield what the recording says, with the seconds since its first read."""
    data = (FOLDER / f"{NAME}.dat").read_bytes()
    rows = (FOLDER / f"{NAME}-timing.csv").read_text("ascii").split()
    reads = [(float(at), int(total)) for at, total in (row.split(",") for row in rows)]
    protocol, position = ZephyrProtocol(), 0
    for at, total in reads:
        for message in protocol.feed(data[position:total]):
            yield at - reads[0][0], message
        position = total


@pytest.fixture(scope="module")
def first() -> dict[str, float]:
    """Seconds to the first value of each stream that has any."""
    seconds: dict[str, float] = {}
    for at, message in messages():
        names = (
            ["breathing"] if isinstance(message, Waveform) and len(message.samples) == 18 else []
        )
        if isinstance(message, Summary):
            names = [name for name, key in NUMBERS.items() if message.numbers[key] is not None]
        for name in names:
            seconds.setdefault(name, at)
    return seconds


def test_the_demo_waits_for_what_the_recording_says_late(first: dict[str, float]) -> None:
    late = {name: filled.after_s for name, filled in RecordedZephyr.filled.items()}
    assert late == {"hrv": ceil(first["hrv"]), "breathing": ceil(first["breathing"]), "st": None}


def test_the_recorded_device_never_tells_its_temperature(first: dict[str, float]) -> None:
    assert "st" not in first
    assert first["hr"] == 0


def twice(number: int, message: Periodic) -> list[Periodic]:
    return [message, message]


def standing_still(number: int, message: Periodic) -> list[Periodic]:
    return [replace(message, header=replace(message.header, sequence=7))]


def begun_again(number: int, message: Periodic) -> list[Periodic]:
    """Number the packets from 0 again, every 20 s or so."""
    sequence = (message.header.sequence + 100 * (number // 200)) % 256
    return [replace(message, header=replace(message.header, sequence=sequence))]


def as_it_is(number: int, message: Periodic) -> list[Periodic]:
    return [message]


def emitted(spoil: Callable[[int, Periodic], list[Periodic]]) -> EmitterSink:
    sink = EmitterSink("zephyr")
    emitter = ZephyrEmitter(sink)
    for number, (at, message) in enumerate(messages()):
        for each in spoil(number, message) if isinstance(message, Periodic) else [message]:
            emitter.take(each, at)
    return sink


@pytest.mark.parametrize("spoil", [twice, standing_still, begun_again])
def test_numbers_that_the_stamps_contradict_change_nothing(
    spoil: Callable[[int, Periodic], list[Periodic]],
) -> None:
    whole, spoilt = emitted(as_it_is), emitted(spoil)
    assert len(whole.values("ecg")) == 597 * 63
    assert (whole.losses, spoilt.losses) == ({}, {})
    assert spoilt.emitted == whole.emitted
    assert spoilt.times == whole.times
