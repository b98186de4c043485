"""How late an event loop is, and that nobody takes it for a device's clock that was set."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Callable

import psutil
import pytest

from biosensor_common import child
from biosensor_common.child import LONGEST_DELAY_S, STABLE_AFTER_S, Backoff
from biosensor_gateway.agent.device_set import KEPT_S, MOST_S, TICK_S, TURNS, LoopLag
from biosensor_gateway.devices.brainflow import driver as board
from biosensor_gateway.devices.brainflow.driver import BrainFlowSettings
from biosensor_gateway.system.child import start_beside

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
def test_a_program_that_outlives_this_one_leaves_no_zombie_if_it_does_not(
    until: Callable[[Callable[[], bool]], None],
) -> None:
    before = set(psutil.Process().children())
    start_beside(["--version"])
    until(lambda: not set(psutil.Process().children()) - before)
