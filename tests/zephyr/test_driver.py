"""The driver against a virtual BioHarness on a real serial port, under its supervisor."""

from __future__ import annotations

import asyncio
import re
from collections import deque
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.zephyr import driver as module
from biosensor_gateway.devices.zephyr.driver import DRIVER, ZephyrDriver, ZephyrSettings
from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.simulator import wire
from biosensor_gateway.devices.zephyr.simulator.bioharness import Outgoing
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.devices.zephyr.simulator.zephyr import DEFAULT_CLOCK, SyntheticSource
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.streaming import stages
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from tests.rigs.driver_run import NotedSink, Run, supervised
from tests.rigs.polling import eventually
from tests.rigs.zephyr import ROOMY_BYTES, SteeredBioHarness, is_damaged

DEADLINE_S = 30.0
WAVEFORMS = {"ecg": Packet.ECG, "breathing": Packet.BREATHING, "acc": Packet.ACCELERATION}
ENABLES = (0x16, 0x15, 0x19, 0x1E, 0xBD)
ALL_PACKETS = {*WAVEFORMS.values(), Packet.RR, Packet.SUMMARY}
LIFESIGN = 0x23

Floats = NDArray[np.float64]


class BlockSink(NotedSink):
    """Notes also which samples came in one packet."""

    def __init__(self) -> None:
        super().__init__("zephyr")
        self.blocks: dict[str, list[Floats]] = {name: [] for name in self.rows}

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        before = len(self.rows[data_name])
        super().emit(data_name, samples, device_times)
        self.blocks[data_name].append(np.array(self.rows[data_name][before:], np.float64))

    def has_blocks(self, *data_names: str, blocks: int = 1) -> Callable[[], bool]:
        return lambda: all(len(self.blocks[name]) >= blocks for name in data_names)


class BioHarnessRun(Run):
    """The supervisor of a steered device, and what came of it."""

    sink: BlockSink

    def __init__(self, device: SteeredBioHarness) -> None:
        self.device, sink = device, BlockSink()
        settings = ZephyrSettings(sensor="zephyr", unit=sink.identity.unit, port=device.port)
        self._begin(sink, DRIVER.make(settings, sink))

    def arrived(self, data_name: str) -> list[Outgoing]:
        """Return the packet that each block came from; the noise makes every one unlike all others.

        Raises StopIteration for a block that the device did not send, or not in this order.
        """
        sent = iter([out for out in self.device.sent if out.packet is WAVEFORMS[data_name]])
        return [next(out for out in sent if np.array_equal(in_units(data_name, out.samples), block))
                for block in self.sink.blocks[data_name]]  # fmt: skip


def in_units(data_name: str, counts: Any) -> Floats:
    counts = np.asarray(counts, np.float64)
    return (counts - 512) / 20.75 if data_name == "acc" else counts


@pytest.fixture(autouse=True)
def fast_heart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Believe beats that come faster than time passes, as those of `fast` devices do."""
    monkeypatch.setattr(stages, "AHEAD_LIMIT_S", inf)


@asynccontextmanager
async def streaming(device: SteeredBioHarness) -> AsyncGenerator[BioHarnessRun]:
    """Run until the block ends; then nothing may have been refused or be half closed."""
    with device:
        async with supervised(BioHarnessRun(device)) as run:
            yield run


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(module, "REPLY_TIMEOUT_S", 0.3)


def fast(**options: Any) -> SteeredBioHarness:
    source = SyntheticSource(seed=3, speed=10, hrv_after_s=0, wearer=Wearer(3, 75))
    return SteeredBioHarness(source, buffer_bytes=ROOMY_BYTES, **options)


async def test_it_enables_keeps_awake_and_disables(monkeypatch: pytest.MonkeyPatch) -> None:
    assert module.LIFESIGN_PERIOD_S == 2.0
    monkeypatch.setattr(module, "LIFESIGN_PERIOD_S", 0.1)
    device = fast(host_timeout_s=4.0)
    async with streaming(device) as run:

        def lifesigns() -> int:  # fmt: skip
            return [request.request_id for request in device.requests].count(LIFESIGN)

        # By then this device would have forgotten a silent host.
        await eventually(lambda: lifesigns() > 45)
        assert device.enabled == ALL_PACKETS
        assert run.states == [State.CONNECTING, State.STREAMING]
        heard = [request for request in device.requests if request.request_id != LIFESIGN]
        assert [request.request_id for request in heard] == list(ENABLES)
    stopped = [request for request in device.requests if request.request_id != LIFESIGN][5:]
    assert {(request.request_id, any(request.payload)) for request in stopped} == {
        (request_id, False) for request_id in ENABLES
    }
    assert all(request.intact for request in device.requests)


@pytest.mark.usefixtures("hasty")
async def test_refused_packets_leave_the_others() -> None:
    async with streaming(fast(refused=[0x15, 0x1E])) as run:
        await eventually(run.sink.has_blocks("ecg", "hr", "ibi", blocks=3))
        assert run.device.enabled == ALL_PACKETS - {Packet.BREATHING, Packet.ACCELERATION}
        said = str(run.supervisor.last_error)
    assert run.sink.blocks["breathing"] == run.sink.blocks["acc"] == []
    assert said.startswith("connected, but the device refuses ")
    assert {"acc", "breathing"} <= set(re.findall(r"\w+", said))


@pytest.mark.usefixtures("hasty")
async def test_a_device_that_refuses_everything_is_left_alone() -> None:
    device = fast(refused=[*ENABLES, 0x14])
    async with streaming(device) as run:
        await eventually(lambda: run.supervisor.state is State.BACKOFF)
        assert "refuses every packet" in (run.supervisor.last_error or "")


async def test_without_summaries_general_data_take_their_place() -> None:
    async with streaming(fast(summary_supported=False)) as run:
        await eventually(run.sink.has_blocks("hr", "br", "posture", "activity", "bat", "quality"))
        sent = [out.values for out in run.device.sent if out.packet is Packet.GENERAL]
        # What general data lack is said.
        assert {"hrv", "rssi"} <= set(re.findall(r"\w+", str(run.supervisor.last_error)))
    assert sent[0] is not None
    assert run.sink.array("hr")[0, 0] == sent[0]["heart_rate_bpm"]
    assert run.sink.array("bat")[0, 0] == 80
    assert run.sink.blocks["hrv"] == run.sink.blocks["rssi"] == []


class NoSummaries(SyntheticSource):
    """Old firmware: the request is acknowledged, and then nothing comes."""

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        return super().poll(now, enabled - {Packet.SUMMARY})


@pytest.mark.parametrize("source", [NoSummaries(speed=10), SyntheticSource(speed=10)])
async def test_general_data_are_asked_for_only_if_summaries_stay_away(
    monkeypatch: pytest.MonkeyPatch, source: SyntheticSource
) -> None:
    monkeypatch.setattr(module, "SUMMARY_PATIENCE_S", 2.0)
    async with streaming(SteeredBioHarness(source)) as run:
        # Ten a second: the patience is over before.
        await eventually(run.sink.has_blocks("hr", blocks=25))
        general = Packet.GENERAL in run.device.enabled
        said = "hrv and rssi are missing" in str(run.supervisor.last_error)
    assert general == said == isinstance(source, NoSummaries)
    assert run.device.switched_on == frozenset()


@pytest.mark.usefixtures("hasty")
async def test_a_request_that_is_ignored_is_repeated_then_given_up() -> None:
    with fast(ignored=[0x16]) as device:
        sink = BlockSink()
        settings = ZephyrSettings(sensor="zephyr", unit="1", port=device.port)
        driver = ZephyrDriver(settings, sink, ZephyrEmitter(sink))
        with pytest.raises(ProtocolError) as caught:
            await driver.connect()
        await driver.close()
        assert caught.value.reason is ProtocolReason.NO_REPLY
        await eventually(lambda: len(device.requests) >= 4)
    on, off = wire.frame(0x16, b"\1"), wire.frame(0x16, b"\0")
    asked = [wire.frame(request.request_id, request.payload) for request in device.requests]
    # It might have obeyed without a word.
    assert asked == [on, on, on, off]


async def test_a_late_answer_answers_only_its_own_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Well after the first request was given up, well before the last one is.
    monkeypatch.setattr(module, "REPLY_TIMEOUT_S", 0.8)
    device = fast(answer_delay_s=1.2, refused=[0x15])
    async with streaming(device) as run:
        await eventually(lambda: run.supervisor.state is State.STREAMING)
        requests = [request.request_id for request in device.requests]
        assert device.enabled == ALL_PACKETS - {Packet.BREATHING}
        said = str(run.supervisor.last_error)
    assert requests.count(0x16) > 1
    assert "refuses breathing" in said


@pytest.mark.usefixtures("hasty")
async def test_a_stop_while_connecting_disables_what_may_have_been_enabled() -> None:
    device = fast(answer_delay_s=inf)
    async with streaming(device):
        await eventually(lambda: Packet.ECG in device.enabled)
    assert device.switched_on == frozenset()


async def test_samples_that_came_while_connecting_are_not_lost() -> None:
    device = fast(answer_delay_s=0.4)
    async with streaming(device) as run:
        await eventually(run.sink.has_blocks("breathing", "acc", blocks=3))
        first = next(out for out in device.sent if out.packet is Packet.ECG)
        np.testing.assert_array_equal(run.sink.blocks["ecg"][0], first.samples)
    assert run.lost == {}
    numbers = [out.sequence for out in run.arrived("ecg")]
    assert numbers == list(range(first.sequence or 0, (first.sequence or 0) + len(numbers)))


async def assert_only_counted_losses(run: BioHarnessRun) -> None:
    """Nothing invented, nothing doubled; what is missing between two packets is counted."""
    for name in WAVEFORMS:
        packets = run.arrived(name)
        numbers = [out.sequence or 0 for out in packets]
        missing = sum(b - a - 1 for a, b in pairwise(numbers))
        size = len(run.sink.blocks[name][0])
        assert run.sink.counted(name).lost == missing * size
        assert run.sink.counted(name).pushed == len(numbers) * size


async def test_the_samples_of_a_damaged_frame_are_counted_as_lost() -> None:
    async with streaming(fast()) as run:
        await eventually(run.sink.has_blocks(*WAVEFORMS))
        damaged: set[Packet | None] = set()
        while not damaged >= {Packet.ECG, Packet.ACCELERATION}:
            run.device.corrupt_next()
            count = len(run.sink.blocks["ecg"])
            await eventually(run.sink.has_blocks("ecg", blocks=count + 2))
            damaged = {out.packet for out in run.device.sent if is_damaged(out)}
        for name in WAVEFORMS:
            await eventually(run.sink.has_blocks(name, blocks=len(run.sink.blocks[name]) + 2))
        spoilt = [len(out.data) for out in run.device.sent if is_damaged(out)]
    assert run.lost["ecg"] >= 63
    assert run.sink.dropped_bytes == sum(spoilt)
    await assert_only_counted_losses(run)


@pytest.mark.parametrize("step_s", [None, 3600.0, -3600.0], ids=["midnight", "ahead", "back"])
async def test_the_device_s_clock_may_turn_midnight_or_be_set(step_s: float | None) -> None:
    async with streaming(SteeredBioHarness(SyntheticSource())) as run:
        await eventually(run.sink.has_blocks("breathing", "hr"))
        if step_s is None:
            run.device.midnight(seconds=0.5)
        else:
            run.device.step_clock(step_s)
        await eventually(run.sink.has_blocks("breathing", "hr", blocks=3))
        days = {out.stamp.day for out in run.device.sent if out.stamp}
    assert len(days) == (2 if step_s is None else 1)
    assert run.lost == {}
    await assert_only_counted_losses(run)


class Script:
    """A source that sends what a test gives it, as soon as a packet is enabled."""

    speaks_lifesigns = False

    def __init__(self) -> None:
        # Filled by the test while the world's thread empties it.
        self.pieces: deque[bytes] = deque()

    def power_on(self, clock: Clock) -> None: ...
    def connection_ended(self) -> None: ...

    def poll(self, now: float, enabled: frozenset[Packet]) -> Iterable[Outgoing]:
        del now
        sent: list[Outgoing] = []
        while enabled and self.pieces:
            sent.append(Outgoing(self.pieces.popleft()))
        return sent

    def next_due(self) -> float:
        return LSL_CLOCK() + 0.01

    def hangs_up(self, now: float) -> bool:
        del now
        return False


def ecg_frame(number: int) -> bytes:
    stamp = DEFAULT_CLOCK.plus(number * 252)
    return wire.waveform(Packet.ECG, number, stamp, [number] * 63)


async def test_a_torn_frame_is_given_up_and_hides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TORN_FRAME_S", 0.3)
    script = Script()
    async with streaming(SteeredBioHarness(script)) as run:
        await eventually(lambda: run.supervisor.state is State.STREAMING)
        torn = ecg_frame(1)[:10]
        # The rest never comes, and the frame behind is too short not to pass for it.
        breathing = wire.waveform(Packet.BREATHING, 0, DEFAULT_CLOCK, list(range(18)))
        script.pieces.extend([ecg_frame(0), torn + breathing])
        await eventually(run.sink.has_blocks("ecg", "breathing"))
        script.pieces.append(ecg_frame(2))
        await eventually(run.sink.has_blocks("ecg", blocks=2))
        script.pieces.append(ecg_frame(3)[:7])
        await eventually(lambda: run.sink.dropped_bytes == len(torn) + 7)
    np.testing.assert_array_equal(run.sink.array("breathing")[:, 0], range(18))
    assert [block[0, 0] for block in run.sink.blocks["ecg"]] == [0, 2]
    assert run.lost == {"ecg": 63}


async def test_a_pause_within_a_frame_is_no_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    assert module.TORN_FRAME_S > 0.51
    monkeypatch.setattr(module, "TORN_FRAME_S", 2 * DEADLINE_S)
    script = Script()
    async with streaming(SteeredBioHarness(script)) as run:
        await eventually(lambda: run.supervisor.state is State.STREAMING)
        script.pieces.append(ecg_frame(0)[:50])
        await asyncio.sleep(0.4)
        script.pieces.append(ecg_frame(0)[50:])
        await eventually(run.sink.has_blocks("ecg"))
    assert run.sink.dropped_bytes == 0


async def test_samples_in_the_same_read_as_an_answer_are_not_lost() -> None:
    script = Script()
    device = SteeredBioHarness(script, ignored=[0x15])
    async with streaming(device) as run:
        await eventually(lambda: 0x15 in [request.request_id for request in device.requests])
        script.pieces.append(ecg_frame(0) + wire.response(0x15, accepted=True) + ecg_frame(1))
        await eventually(lambda: run.supervisor.state is State.STREAMING)
        script.pieces.append(ecg_frame(2))
        await eventually(lambda: 2 in run.sink.array("ecg"))
    assert [block[0, 0] for block in run.sink.blocks["ecg"]] == [0, 1, 2]


def without_a_date(frame: bytes) -> bytes:
    payload = frame[3:4] + bytes(4) + frame[8:-2]
    return wire.frame(frame[1], payload)


async def test_a_device_whose_clock_was_never_set_is_stamped_by_arrival() -> None:
    script = Script()
    async with streaming(SteeredBioHarness(script)) as run:
        await eventually(lambda: run.supervisor.state is State.STREAMING)
        for number in (0, 1, 2, 5, 6):
            script.pieces.append(without_a_date(ecg_frame(number)))
            await asyncio.sleep(0.1)
        await eventually(run.sink.has_blocks("ecg", blocks=5))
        stamp = run.sink.counted("ecg").last_stamp
        assert abs(stamp - LSL_CLOCK()) < 5
    assert run.lost == {"ecg": 2 * 63}
    assert [block[0, 0] for block in run.sink.blocks["ecg"]] == [0, 1, 2, 5, 6]
