"""The clocks of senders are measured again and again, and silent senders are named."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.lsl import network, sender_clocks
from biosensor_common.lsl.sender_clocks import PERIOD_S, Measurement, SenderClocks
from lsl_to_ros.lsl import discovery
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.faults.agent import AgentProcess
from tests.rigs.lsl_streams import DEADLINE_S, Collector, Open, Source, inlets, thread_count
from tests.rigs.polling import wait_until

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
SILENT = "nothing received for"
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
        lambda: before < said() == node.count("[INFO]", f"{host}: data arrives again"),
        "a return of each silence",
    )


# A stream that is seen again after a cut and not heard: the first inlet that brings something.

# Longer than the resolver remembers, and less than a test may take.
FORGET_S, PATIENCE_S, SILENT_S = 1.0, 1.0, 3.0

# Pushes as many samples as each line says, numbered on, and says when it has done so.
PROGRAM = """
import sys, time
import pylsl
info = pylsl.StreamInfo(sys.argv[1], "Test", 1, 100.0, "float32", sys.argv[1])
outlet = pylsl.StreamOutlet(info)
pushed = 0
for line in sys.stdin:
    # An inlet that is open may not be heard of yet.
    outlet.wait_for_consumers(30.0)
    for _ in range(int(line)):
        outlet.push_sample([pushed], 1000.0 + pushed / 1024)
        pushed += 1
        time.sleep(0.001)
    print(pushed, flush=True)
"""


class Sender:
    """Another program, which can be starved."""

    def __init__(self) -> None:
        self.pushed = 0
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, f"starved-{uuid.uuid4().hex}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def push(self, count: int) -> None:
        """Have so many samples pushed, and return once they are."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{count}\n")
        self.process.stdin.flush()
        self.pushed = int(self.process.stdout.readline())


class Node:
    """What the node does with its streams, in the thread of the test."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.receiver = Collector()
        self.discovery = Discovery(self.warnings.append)
        self.deaf: list[Inlet] = []
        self.gone: list[Inlet] = []

    @property
    def has_warned(self) -> bool:
        return any("seen again after an interruption" in each for each in self.warnings)

    def look(self) -> None:
        ready, gone = self.discovery.update()
        self.gone += gone
        for inlet in ready:
            inlet.deliver_to(self.receiver)
        for inlet in self.discovery.inlets:
            if inlet.state is InletState.READY and inlet not in self.deaf:
                inlet.drain()

    def hears(self, count: int) -> bool:
        self.look()
        return self.receiver.count >= count

    def notices(self) -> bool:
        self.look()
        return self.has_warned


@pytest.fixture
def sender() -> Iterator[Sender]:
    sender = Sender()
    yield sender
    sender.process.kill()
    sender.process.communicate()


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    monkeypatch.setattr(network, "FORGET_AFTER_S", FORGET_S)
    monkeypatch.setattr(discovery, "PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(discovery, "SEEN_AGAIN_S", 0.5)
    node = Node()
    yield node
    node.discovery.stop()


def attach(node: Node, sender: Sender) -> Inlet:
    """Return the inlet of a sender of which ten samples were heard."""

    def delivers() -> bool:
        node.look()
        return any(inlet.is_delivering for inlet in node.discovery.inlets)

    wait_until(delivers, "an inlet that delivers")
    sender.push(10)
    wait_until(lambda: node.hears(10), "ten samples")
    (inlet,) = node.discovery.inlets
    return inlet


def starve(node: Node, sender: Sender) -> None:
    """Give the sender no time for a while, until the node takes it for cut off."""
    sender.process.send_signal(signal.SIGSTOP)
    end = time.monotonic() + SILENT_S
    wait_until(lambda: node.look() or time.monotonic() > end, "the end of the pause")
    sender.process.send_signal(signal.SIGCONT)
    wait_until(node.notices, "a sentence about it")


def test_what_a_starved_sender_sends_on_its_connection_is_not_lost(
    node: Node, sender: Sender, monkeypatch: pytest.MonkeyPatch
) -> None:
    inlet = attach(node, sender)
    starve(node, sender)
    # A busy sender takes its time; that would be silence, and another sentence about it.
    monkeypatch.setattr(discovery, "PATIENCE_S", DEADLINE_S)
    sender.push(127)
    wait_until(lambda: node.hears(137), "what was sent since")
    sender.push(100)
    wait_until(lambda: node.hears(237), "what was sent after that")
    node.receiver.assert_all(0, 237)
    assert node.discovery.inlets == [inlet]
    assert (node.gone, len(node.warnings)) == ([], 1)


@pytest.mark.seam
def test_a_connection_that_brings_nothing_is_given_up_for_one_that_does(
    node: Node, sender: Sender
) -> None:
    old = attach(node, sender)
    node.deaf.append(old)
    starve(node, sender)
    assert node.discovery.inlets == [old]

    def is_replaced() -> bool:
        # Samples come before the second connection is there, and after.
        sender.push(1)
        node.look()
        return node.gone == [old]

    wait_until(is_replaced, "another inlet")
    last = sender.pushed
    wait_until(lambda: node.hears(10) and node.receiver.samples[-1][0] == last - 1, "the newest")
    numbers = [int(sample[0]) for sample in node.receiver.samples]
    first = numbers[10]
    assert numbers == [*range(10), *range(first, last)]
    assert node.receiver.ends == [0]
    assert len(node.warnings) == 1
    old.stop().join(DEADLINE_S)
