"""The clocks of senders are measured again and again, and silent senders are named."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.lsl import sender_clocks
from biosensor_common.lsl.sender_clocks import PERIOD_S, Measurement, SenderClocks
from lsl_to_ros.lsl.inlets import Inlet
from tests.faults.agent import AgentProcess
from tests.rigs.lsl_streams import Collector, Open, Source, inlets, thread_count, wait_until

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

# The clocks of senders are measured again and again, and nothing stays of a measurement.

STEADY_S = 0.5


@pytest.fixture
def open_inlet() -> Iterator[Open]:
    with inlets(lambda _: None) as open_:
        yield open_


Watch = Callable[..., SenderClocks]


@pytest.fixture
def watch() -> Iterator[Watch]:
    started: list[SenderClocks] = []

    def start(present: list[Inlet], period_s: float = PERIOD_S) -> SenderClocks:
        started.append(SenderClocks(lambda: present, period_s))
        return started[-1]

    yield start
    for clocks in started:
        clocks.stop()


def threads_at_rest(sources: Iterable[Source]) -> int:
    """Count the threads of this process once those that open something are gone.

    No inlet is being opened any more, the outlets have a thread for each inlet, and what is
    left of tests before this one has ended.
    """

    def opening() -> bool:
        return any(thread.name.startswith("open ") for thread in threading.enumerate())

    wait_until(lambda: not opening(), "inlets that are open")
    for source in sources:
        source.await_inlet()
    count, since_s = thread_count(), time.monotonic()

    def is_steady() -> bool:
        nonlocal count, since_s
        if (now := thread_count()) != count:
            count, since_s = now, time.monotonic()
        return time.monotonic() - since_s > STEADY_S

    wait_until(is_steady, "a number of threads that stays")
    return count


@pytest.mark.seam
def test_a_senders_clock_is_said_once_and_measured_again_and_again(
    open_inlet: Open, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Source()
    inlet, first, second = open_inlet(source.find()), Collector(), Collector()
    corrections: list[float] = []
    take = inlet.take_correction

    def note(correction: float) -> None:
        corrections.append(correction)
        take(correction)

    monkeypatch.setattr(inlet, "take_correction", note)
    inlet.deliver_to(first)
    watch([inlet], 0.2)
    wait_until(lambda: len(corrections) >= 3, "three measurements")
    assert first.clocks == 1
    inlet.deliver_to(second)
    assert (first.clocks, second.clocks) == (1, 1)
    # Both clocks are this machine's.
    assert inlet.correction == pytest.approx(0.0, abs=0.01)
    assert 0.0 <= inlet.correction_spread < 0.01


def test_nothing_stays_of_a_measurement(open_inlet: Open, watch: Watch) -> None:
    sources = [Source() for _ in range(3)]
    opened = [open_inlet(source.find()) for source in sources]
    threads = threads_at_rest(sources)
    watch(opened)
    wait_until(lambda: all(each.correction is not None for each in opened), "all clocks")
    # liblsl's thread that measures lives as long as the inlet that was asked.
    wait_until(lambda: thread_count() == threads + 1, "no thread but that of the watch")


def test_an_inlet_that_is_gone_is_not_measured_any_more(
    open_inlet: Open, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Measurement] = []

    def measure(clock: pylsl.StreamInlet) -> Measurement:
        begun.append(Measurement(clock))
        present.clear()
        return begun[-1]

    monkeypatch.setattr(sender_clocks, "Measurement", measure)
    source = Source()
    inlet = open_inlet(source.find())
    present, threads = [inlet], threads_at_rest([source])
    watch(present)
    wait_until(lambda: begun, "a measurement")
    begun.clear()
    wait_until(lambda: thread_count() == threads + 1, "its end")
    assert inlet.correction is None


# A computer from which nothing comes any more: soon said, of every stream, and once.
TOPICS = tuple(f"/biosensors/zephyr/{name}" for name in ("ecg", "hr", "bat"))
COUNTERS = "/biosensors/gateway/counters"
SILENT = "nothing has come for"
HELD_S = 3.0


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[AgentProcess]:
    with AgentProcess(tmp_path, "--simulate", "zephyr", environment={}) as agent:
        yield agent


def test_an_agent_that_stands_still_is_said_of_all_its_streams(
    ros: Ros, start_node: Callable[..., RunningNode], agent: AgentProcess
) -> None:
    node, host = start_node(), socket.gethostname()

    def levels() -> set[bytes]:
        statuses = [ros.status(topic) for topic in (*TOPICS, COUNTERS)]
        return {status.level if status else b"absent" for status in statuses}

    def said() -> int:
        return node.count("[WARN]", f"{host}: {SILENT}")

    ros.until(lambda: levels() == {DiagnosticStatus.OK}, "all streams")
    before = said()
    begun_s = time.monotonic()
    os.kill(agent.pid, signal.SIGSTOP)
    try:
        ros.until(lambda: levels() == {DiagnosticStatus.STALE}, "what the diagnostics say")
        said_s = time.monotonic() - begun_s
        status = ros.status(TOPICS[1])
        assert status is not None
        assert status.message.startswith(f"{host}: {SILENT}")
        ros.spin(HELD_S)
    finally:
        os.kill(agent.pid, signal.SIGCONT)
    print(f"said after {said_s:.1f} s")
    ros.until(lambda: levels() == {DiagnosticStatus.OK}, "all streams again")
    # What is written comes by another way than the diagnostics. On a busy machine nothing may
    # come for a second time; that is said, too, and so is each return.
    ros.until(
        lambda: before < said() == node.count("[INFO]", f"{host}: it is heard again"),
        "a return of each silence",
    )
