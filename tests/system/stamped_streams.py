"""Both ends of a stamped topic: a stream of another program, and a subscriber."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pylsl

from tests.system.programs import Program
from tests.system.stamped_messages import Sample, samples_of

DEADLINE_S = 30.0


class Source:
    """A stream of another program; its samples are numbered where nothing else is said."""

    def __init__(self, name: str, content_type: str, form: str, channels: int, rate: float) -> None:
        self._info = pylsl.StreamInfo(
            name, content_type, channels, rate, form, f"test-{name}-{form}"
        )
        self._outlet: pylsl.StreamOutlet | None = None
        self.topic = f"/biosensors/{name}/{content_type}_stamped"
        self.channels = channels
        self.pushed = 0
        self.restart()

    def restart(self) -> None:
        """End the outlet and make another one of the same source_id."""
        self._outlet = None
        self._outlet = pylsl.StreamOutlet(self._info)

    def push(self, rows: Sequence[Sequence[Any]], stamps: Sequence[float]) -> None:
        """Push samples that LSL hands on together."""
        assert self._outlet is not None
        self._outlet.push_chunk([list(row) for row in rows], list(stamps))

    def push_number(self) -> None:
        """Push one sample, measured now, whose values are its number."""
        self.push([[self.pushed] * self.channels], [pylsl.local_clock()])
        self.pushed += 1


class Listener:
    """What a process that subscribes to topics has received."""

    def __init__(self, program: Program) -> None:
        self._program = program

    @property
    def received(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Topics and messages in the order of their arrival."""
        return [(record["topic"], record["message"]) for record in self._program.records]

    def messages(self, topic: str) -> list[Mapping[str, Any]]:
        return [message for name, message in self.received if name == topic]

    def samples(self, topic: str) -> list[Sample]:
        return samples_of(self.messages(topic))

    def wait_until(
        self, condition: Callable[[], object], what: str, meanwhile: Callable[[], object] = int
    ) -> None:
        """Wait for something, doing something else again and again."""
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            said = self._program.output[-2000:]
            assert time.monotonic() < deadline, f"{what} did not come:\n{said}"
            meanwhile()
            time.sleep(0.05)
