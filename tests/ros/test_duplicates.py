"""A stream that is seen again after a cut and not heard: the first inlet that brings something."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator

import pytest

from biosensor_common.lsl import network
from lsl_to_ros.lsl import discovery
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.rigs.lsl_streams import DEADLINE_S, Collector, wait_until

pytestmark = pytest.mark.nightly

# Longer than the resolver remembers, and less than a test may take.
FORGET_S, PATIENCE_S, HELD_S = 1.0, 1.0, 3.0

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
        return any("seen again after a cut" in each for each in self.warnings)

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
    end = time.monotonic() + HELD_S
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
