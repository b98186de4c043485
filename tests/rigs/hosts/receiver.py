"""An LSL program like any other: receives every stream of the lab and keeps what comes.

    python -m tests.rigs.hosts.receiver

Steered: ``state`` tells how many samples came of each open stream, by source_id;
``save`` writes them to ``path``.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pylsl

from biosensor_common.quantities import ContentType
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import Recording, canonical
from tests.rigs.hosts.programs import Dialogue

PERIOD_S = 0.01
LOOK_S = 0.25
BATCH_SAMPLES = 4096


class Stream:
    """One inlet and what came over it."""

    def __init__(self, info: pylsl.StreamInfo) -> None:
        self._is_counters = info.type() == ContentType.COUNTERS
        self._is_text = info.channel_format() == pylsl.cf_string
        self._inlet = pylsl.StreamInlet(info)
        self.is_open = False
        threading.Thread(target=self._open, daemon=True).start()
        self._arrivals: list[float] = []
        self._stamps: list[float] = []
        self._samples: list[list[Any]] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def pull(self) -> None:
        """Take what has come, without waiting."""
        if not self.is_open:
            return
        samples, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=BATCH_SAMPLES)
        if len(stamps):
            self._arrivals.extend([time.time()] * len(stamps))
            self._stamps.extend(stamps)
            self._samples.extend(self._row(sample) for sample in samples)

    def _row(self, sample: Sequence[Any]) -> list[Any]:
        return [canonical(json.loads(sample[0]))] if self._is_counters else list(sample)

    def _open(self) -> None:
        self._inlet.open_stream()
        self.is_open = True

    def recording(self) -> Recording:
        rows = np.array(self._samples, np.str_ if self._is_text else np.float32)
        return Recording(
            np.array(self._arrivals, np.float64),
            np.array(self._stamps, np.float64),
            rows.reshape(len(self._samples), -1) if len(rows) else rows.reshape(0, 1),
        )


class Receiver:
    """All streams, by source_id."""

    def __init__(self) -> None:
        self._resolver = pylsl.ContinuousResolver()
        self._streams: dict[str, Stream] = {}
        self._next_look = 0.0

    def pull(self) -> None:
        """Take what has come of every stream, and look for new ones from time to time."""
        if time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + LOOK_S
            for info in self._resolver.results():
                if info.source_id() not in self._streams:
                    self._streams[info.source_id()] = Stream(info)
        for stream in self._streams.values():
            stream.pull()

    def obey(self, command: Mapping[str, Any]) -> Any:
        match command["do"]:
            case "state":
                return {s: len(each) for s, each in self._streams.items() if each.is_open}
            case "save":
                received = {source: each.recording() for source, each in self._streams.items()}
                completeness.save(Path(command["path"]), received)
                return None
            case other:
                raise ValueError(f"what is {other!r}?")


def main() -> None:
    receiver = Receiver()
    dialogue = Dialogue()
    while not dialogue.ended:
        receiver.pull()
        dialogue.answer(receiver.obey)
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
