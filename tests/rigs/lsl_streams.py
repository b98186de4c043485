"""Outlets in the process of the tests, inlets, and a receiver that keeps what they deliver."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest

from biosensor_common.lsl.inlet import Block
from biosensor_common.refusal import Refusals
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.rigs.polling import wait_until

DEADLINE_S = 30.0

Open = Callable[[pylsl.StreamInfo], Inlet]
"""Opens an inlet and waits until it is ready."""


class Source:
    """An outlet of another program, with a name of its own at every start."""

    def __init__(
        self,
        channel_format: str = "float32",
        channels: int = 1,
        rate: float = 0.0,
        name: str = "",
        info: pylsl.StreamInfo | None = None,
    ) -> None:
        name = name or f"source-{uuid.uuid4().hex}"
        self.info = info or pylsl.StreamInfo(name, "Test", channels, rate, channel_format, name)
        self.outlet = pylsl.StreamOutlet(self.info)
        self.pushed = 0

    def find(self) -> pylsl.StreamInfo:
        """Return what a resolver says of it."""
        found = pylsl.resolve_byprop("source_id", self.info.source_id(), timeout=DEADLINE_S)
        assert len(found) == 1
        return found[0]

    def await_inlet(self) -> None:
        """Return once an inlet gets what is pushed: one that is open may not be heard of yet."""
        assert self.outlet.wait_for_consumers(DEADLINE_S)

    def push(self, count: int) -> None:
        """Push so many samples at once: numbers counted on from 0, in every channel."""
        self.await_inlet()
        numbers = np.arange(self.pushed, self.pushed + count, dtype=np.float32)
        samples = np.repeat(numbers[:, np.newaxis], self.info.channel_count(), axis=1)
        self.outlet.push_chunk(samples, [stamp_of(int(number)) for number in numbers])
        self.pushed += count

    def end(self) -> None:
        """Let the outlet die."""
        del self.outlet


def stamp_of(number: int) -> float:
    """Return the LSL time that the sample of that number has."""
    return 1000.0 + number / 1024


class Collector:
    """Keeps what an inlet delivers."""

    def __init__(self, *, wants_each_sample: bool = False) -> None:
        self.wants_each_sample = wants_each_sample
        self.is_full = False
        self.blocks: list[Block] = []
        self.ends: list[int] = []  # What it was told at each end: how many samples LSL dropped.
        self.clocks = 0  # How often it was told that the sender's clock is known.
        self.overlaps = 0  # Calls that came while another one was still running.
        self._busy = threading.Lock()

    def receive(self, block: Block) -> None:
        self._alone(lambda: self.blocks.append(block))

    def clock_known(self) -> None:
        self._alone(self._count_clock)

    def end(self, undelivered: int) -> None:
        self._alone(lambda: self.ends.append(undelivered))

    @property
    def count(self) -> int:
        """How many samples there are."""
        return sum(len(block.stamps) for block in list(self.blocks))

    @property
    def samples(self) -> list[Any]:
        """All samples, in the order in which they came."""
        return [sample for block in list(self.blocks) for sample in block.samples.tolist()]

    @property
    def stamps(self) -> list[float]:
        return [stamp for block in list(self.blocks) for stamp in block.stamps.tolist()]

    def assert_all(self, start: int, end: int) -> None:
        """Check that these samples of a :class:`Source` came once and in order."""
        assert [int(sample[0]) for sample in self.samples] == list(range(start, end))
        assert self.stamps == [stamp_of(number) for number in range(start, end)]
        assert self.overlaps == 0
        for block in self.blocks:
            assert block.samples.ndim == 2
            assert len(block.samples) == len(block.stamps) > 0

    def _count_clock(self) -> None:
        self.clocks += 1

    def _alone(self, work: Callable[[], None]) -> None:
        if not self._busy.acquire(blocking=False):
            self.overlaps += 1
            return
        try:
            # Whoever else comes in between is found out.
            time.sleep(0)
            work()
        finally:
            self._busy.release()


@contextmanager
def inlets(warn: Callable[[str], None]) -> Generator[Open]:
    """Open inlets that are closed in the end."""
    opened: list[Inlet] = []

    def open_(info: pylsl.StreamInfo) -> Inlet:
        inlet = Inlet(info, Refusals(warn))
        opened.append(inlet)
        wait_until(lambda: inlet.state is not InletState.OPENING, "an inlet that is open")
        assert inlet.state is InletState.READY
        return inlet

    yield open_
    for inlet in opened:
        inlet.stop().join(DEADLINE_S)


def keep_lsl_inlets(monkeypatch: pytest.MonkeyPatch) -> list[pylsl.StreamInlet]:
    """Return a list of the inlets of liblsl that are made from now on."""
    made: list[pylsl.StreamInlet] = []
    make = pylsl.StreamInlet

    def make_and_keep(*arguments: Any, **options: Any) -> pylsl.StreamInlet:
        made.append(make(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(pylsl, "StreamInlet", make_and_keep)
    return made


def note_askers(
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[list[pylsl.StreamInlet], list[pylsl.StreamInlet]]:
    """Return lists of the inlets that are asked for a clock, and of those that bring data."""
    asked: list[pylsl.StreamInlet] = []
    pulled: list[pylsl.StreamInlet] = []
    ask, pull = pylsl.StreamInlet.time_correction, pylsl.StreamInlet.pull_chunk

    def note_asked(inlet: pylsl.StreamInlet, timeout: float) -> float:
        asked.append(inlet)
        return ask(inlet, timeout)

    def note_pulled(inlet: pylsl.StreamInlet, *arguments: Any, **options: Any) -> Any:
        pulled.append(inlet)
        return pull(inlet, *arguments, **options)

    monkeypatch.setattr(pylsl.StreamInlet, "time_correction", note_asked)
    monkeypatch.setattr(pylsl.StreamInlet, "pull_chunk", note_pulled)
    return asked, pulled


def drain_until(inlet: Inlet, receiver: Collector, count: int) -> None:
    """Drain until a receiver has so many samples."""

    def has_all() -> bool:
        inlet.drain()
        return receiver.count >= count

    wait_until(has_all, f"{count} samples")


def thread_count() -> int:
    """Count the threads of this process, liblsl's own among them."""
    return len(list(Path("/proc/self/task").iterdir()))
