"""From a driver's samples to stamped, counted ones; how late an event loop is."""

from __future__ import annotations

import asyncio
import math
import os
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Generator

import numpy as np
import psutil
import pylsl
import pytest
from structlog.testing import capture_logs

from biosensor_common import child
from biosensor_common.child import LONGEST_DELAY_S, STABLE_AFTER_S, Backoff
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent.device_set import KEPT_S, MOST_S, TICK_S, TURNS, LoopLag
from biosensor_gateway.devices.brainflow import driver as board
from biosensor_gateway.devices.brainflow.driver import BrainFlowSettings
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import WAITED_S, Arrivals, Charge, DeviceSink
from biosensor_gateway.system.child import start_beside
from tests.rigs.gateway import inlet
from tests.rigs.polling import wait_until

ECG_PERIOD_S = 0.004
DEVICE_S = 8.2e8


@pytest.fixture
def sink(unit: str) -> Generator[DeviceSink]:
    opened = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"))
    opened.open(DeviceInfo(), {})
    yield opened
    opened.close()


def counters(sink: DeviceSink, data_name: str) -> Counters:
    return sink.counters[f"zephyr-{sink.identity.unit}-{data_name}"]


def times(count: int, start_s: float = DEVICE_S) -> list[float]:
    return [start_s + ECG_PERIOD_S * index for index in range(count)]


@pytest.mark.seam
def test_device_times_become_lsl_stamps(sink: DeviceSink) -> None:
    reader = inlet(f"zephyr-{sink.identity.unit}-ecg")
    arrival = pylsl.local_clock()
    device_times = times(63)
    sink.observe(device_times[-1], arrival)
    sink.emit("ecg", list(range(63)), device_times)
    for index in range(63):
        sample, stamp = reader.pull_sample(timeout=20.0)
        assert sample == [index]
        # The packet's last sample was measured when it arrived; the others 4 ms apart.
        assert stamp == pytest.approx(arrival - (62 - index) * ECG_PERIOD_S, abs=1e-6)
    assert counters(sink, "ecg").pushed == 63


@pytest.mark.nightly
def test_stamps_never_run_backwards_when_the_device_clock_does(sink: DeviceSink) -> None:
    reader = inlet(f"zephyr-{sink.identity.unit}-ecg")
    arrival = pylsl.local_clock()
    with capture_logs() as logs:
        for start_s, lag_s in ((DEVICE_S, 0.0), (DEVICE_S - 3600, 0.1), (DEVICE_S + 3600, 0.2)):
            device_times = times(63, start_s)
            sink.observe(device_times[-1], arrival + lag_s)
            sink.emit("ecg", [1.0] * 63, device_times)
    stamps = [reader.pull_sample(timeout=20.0)[1] or math.nan for _ in range(189)]
    assert stamps == sorted(set(stamps))
    assert counters(sink, "ecg") == Counters(pushed=189, last_stamp=stamps[-1])
    jumps = [entry for entry in logs if "jumped" in entry["event"]]
    assert [entry["unit"] for entry in jumps] == [sink.identity.unit] * 2
    assert sink.clock_state.reanchors == 2


@pytest.mark.parametrize(("own_delay_s", "reanchors"), [(0.0, 1), (0.3, 0)])
def test_what_waits_for_a_busy_computer_is_no_step_of_the_device_clock(
    sink: DeviceSink, own_delay_s: float, reanchors: int
) -> None:
    sink.own_delay = lambda: own_delay_s
    begin = pylsl.local_clock() - 20.0
    for packet in range(200):
        late_s = 0.3 if packet > 100 else 0.0
        sink.observe(DEVICE_S + 0.1 * packet, begin + 0.1 * packet + late_s)
    assert sink.clock_state.reanchors == reanchors


@pytest.mark.parametrize("value", [0, 71])
def test_a_value_is_sent(sink: DeviceSink, value: int) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    sink.emit_value("br", value, DEVICE_S)
    assert counters(sink, "br").pushed == 1


def test_no_value_sends_nothing_and_refuses_nothing(sink: DeviceSink) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    sink.emit_value("hr", None, DEVICE_S)
    assert counters(sink, "hr") == Counters()


def test_a_cause_of_refusals_is_logged_once_and_counted_always(sink: DeviceSink) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    with capture_logs() as logs:
        for value in (256, 71, 299, 256):
            sink.emit_value("hr", value, DEVICE_S)
        sink.emit_value("ecg", math.inf, DEVICE_S)
    refusals = [entry for entry in logs if entry["log_level"] == "error"]
    assert [entry["data"] for entry in refusals] == ["hr", "ecg"]
    assert "outside 0..255" in refusals[0]["cause"]
    assert (counters(sink, "hr").refused, counters(sink, "hr").pushed) == (3, 1)


@pytest.mark.parametrize("waited_s", [45.0, 89.0])
def test_what_waited_for_an_agent_that_did_not_run_is_late_and_not_refused(
    sink: DeviceSink, waited_s: float
) -> None:
    now = pylsl.local_clock()
    sink.observe(DEVICE_S, now - waited_s - 1.0)
    sink.observe(DEVICE_S + 1.0, now)
    sink.emit("ecg", [1.0] * 63, times(63, DEVICE_S + 0.748))
    assert (counters(sink, "ecg").refused, counters(sink, "ecg").pushed) == (0, 63)
    assert counters(sink, "ecg").last_stamp == pytest.approx(now - waited_s, abs=0.1)


def test_losses_are_counted_per_stream(sink: DeviceSink) -> None:
    sink.lost("ecg", 63)
    sink.lost("ecg", 126)
    assert counters(sink, "ecg").lost == 189
    assert counters(sink, "acc").lost == 0


def test_counters_outlive_a_connection(sink: DeviceSink) -> None:
    sink.lost("ecg", 63)
    sink.open(DeviceInfo(firmware_version="2"), {})
    assert counters(sink, "ecg").lost == 63


def test_samples_are_signs_of_life_of_their_streams(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("polar_h10", unit), declaration("polar_h10"))
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    assert sink.spec.rates({"acc": 25.0})["acc"] == 25.0
    sink.watch.expect({"ecg": 0.0, "acc": 0.0, "hr": 0.0})
    judged = sink.watch.judge(can_enable=True)
    assert judged is not None
    assert sink.watch.absent == {"ecg", "acc", "hr"}
    sink.emit_at("ecg", [[1.0]], [pylsl.local_clock()])
    sink.heard("hr")
    assert sink.watch.take_came_back() == {"ecg", "hr"}
    # Also what is withheld or refused has come.
    sink.pause()
    sink.emit_at("acc", [[1.0]], [pylsl.local_clock()])
    assert not sink.watch.absent
    sink.close()


def test_every_declared_stream_has_its_counters(sink: DeviceSink) -> None:
    assert len(sink.counters) == 13
    assert all(each == Counters() for each in sink.counters.values())


def test_a_stamp_from_the_future_is_refused_and_holds_nothing_back(sink: DeviceSink) -> None:
    now = pylsl.local_clock()
    sink.emit_at("ecg", [1.0], [now + 3600])
    sink.emit_at("ecg", [2.0, 3.0], [now, now + ECG_PERIOD_S])
    counted = counters(sink, "ecg")
    assert (counted.refused, counted.pushed) == (1, 2)
    assert counted.last_stamp == pytest.approx(now + ECG_PERIOD_S)


@pytest.mark.parametrize("held_s", [1.5, 2.5, 7.2])
def test_all_that_waited_together_is_told_and_the_rest_is_less_than_a_period_late(
    held_s: float,
) -> None:
    """A strap without device times sends a heart rate each second; the link holds them at first."""
    for phase_s in np.arange(0.05, 1.0, 0.1):
        told: list[int] = []
        arrivals = Arrivals(lambda _name, count, _seconds, told=told: told.append(count))
        arrivals.note("hr", 0.0, 1)
        errors_s: list[float] = []
        for number in range(20):
            measured_s = 100.0 - held_s + phase_s + number
            arrival_s = max(100.0 + 0.01 * number, measured_s)
            assert not arrivals.waited_s(arrival_s)
            arrivals.note("hr", arrival_s, 1)
            errors_s.append(arrival_s - measured_s)
        late = sum(error_s > WAITED_S for error_s in errors_s)
        if errors_s[1] > 0.0:
            assert late <= sum(told) <= held_s + 2
        else:
            # One that waited alone: nothing tells so, and the next one came in time.
            assert max(errors_s) < 1.0


HELD_S = 0.3


def hold_up(seconds: float) -> None:
    time.sleep(seconds)


@pytest.fixture
async def lag() -> AsyncGenerator[LoopLag]:
    lag = LoopLag()
    running = asyncio.create_task(lag.run())
    await asyncio.sleep(2 * TICK_S)
    yield lag
    running.cancel()


@pytest.mark.nightly
async def test_a_loop_that_is_held_up_is_late(lag: LoopLag) -> None:
    hold_up(HELD_S)
    # What comes meanwhile is taken in before the lag is measured again.
    assert HELD_S - TICK_S <= lag.seconds() <= MOST_S
    await asyncio.sleep(2 * TICK_S)
    assert HELD_S - TICK_S <= lag.seconds() <= MOST_S


@pytest.mark.nightly
async def test_it_is_forgotten_that_it_was_late(lag: LoopLag) -> None:
    hold_up(HELD_S)
    deadline = time.monotonic() + 30.0
    while lag.seconds() >= HELD_S - TICK_S:
        assert time.monotonic() < deadline
        await asyncio.sleep(TICK_S)
    assert time.monotonic() >= deadline - 30.0 + KEPT_S


@pytest.mark.nightly
async def test_a_stall_counts_as_far_as_a_busy_computer_would(lag: LoopLag) -> None:
    hold_up(2 * MOST_S)
    assert lag.seconds() == MOST_S
    assert lag.packet_delay_s() == TURNS * MOST_S


# Other processes are started apart from this one, end within a limit, and leave nothing behind.
WAITS = [sys.executable, "-c", "import sys; sys.stdin.read()"]
HANGS = [sys.executable, "-c", "import time; time.sleep(600)"]
posix = pytest.mark.skipif(sys.platform == "win32", reason="sessions and zombies are of POSIX")


@pytest.mark.parametrize("first_s", [0.0, 0.5])
def test_a_delay_doubles_up_to_a_limit_and_begins_again_after_a_long_life(first_s: float) -> None:
    backoff = Backoff(first_s)
    delays = [backoff.next_s(lived_s=0.1) for _ in range(8)]
    assert delays == [first_s, 1, 2, 4, 8, 16, LONGEST_DELAY_S, LONGEST_DELAY_S]
    assert backoff.next_s(STABLE_AFTER_S) == first_s
    assert backoff.next_s(STABLE_AFTER_S - 1) == 1


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, "exit code 0"),
        (3, "exit code 3"),
        (0xC0000005, "crash 0xC0000005"),
        (-200, "killed by signal 200"),
    ],
)
def test_an_exit_code_is_put_in_words(code: int, words: str) -> None:
    assert child.ending_in_words(code) == words


@pytest.mark.seam
def test_a_process_that_ends_with_its_input_is_not_killed() -> None:
    with child.start(WAITS, stdin=subprocess.PIPE) as process:
        child.close_input(process)
        assert not child.wait_or_kill(process, 60.0)
    assert process.returncode == 0
    # Whoever is late does no harm.
    child.close_input(process)


@pytest.mark.seam
def test_a_process_that_hangs_is_killed() -> None:
    with child.start(HANGS, stdin=subprocess.PIPE) as process:
        child.close_input(process)
        assert child.wait_or_kill(process, 0.1)
    assert process.returncode


@pytest.mark.seam
@posix
def test_what_is_sent_to_a_process_that_has_ended_is_no_error() -> None:
    with child.start([sys.executable, "-c", ""], stdin=subprocess.PIPE) as process:
        process.wait()
        child.send(process, b"nobody reads this\n")
        child.close_input(process)


@pytest.mark.seam
@posix
def test_ctrl_c_at_the_agents_terminal_does_not_reach_the_program_that_reads_a_board() -> None:
    settings = BrainFlowSettings(sensor="brainflow", unit="1", board="SYNTHETIC_BOARD")
    with board.start(settings, "stream") as process:
        assert os.getsid(process.pid) == process.pid
        process.kill()


@pytest.mark.seam
@posix
def test_a_program_that_outlives_this_one_leaves_no_zombie_if_it_does_not() -> None:
    before = set(psutil.Process().children())
    start_beside(["--version"])
    wait_until(lambda: not set(psutil.Process().children()) - before)


def test_the_newest_known_value_is_the_charge_of_a_battery() -> None:
    charge = Charge(declaration("polar_h10"))
    charge.sampled("bat", [[81.0]], [1.0])
    assert charge.percent == 81.0
    # NaN is "no value", and another stream tells nothing of it.
    charge.sampled("bat", [[80.0], [79.0], [math.nan]], [2.0, 3.0, 4.0])
    charge.sampled("hr", [[60.0]], [5.0])
    assert charge.percent == 79.0
