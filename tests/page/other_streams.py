"""``python -m tests.page.other_streams JSON``: another user's program with LSL outlets.

The argument is a list of streams::

    {"name", "type", "channels", "rate", "format", "source_id", "unit",
     "label": a channel's, "header_bytes": of an element beside the channels,
     "gap_every_s", "gap_s": of so many seconds, the last so many without a sample,
     "stamps": "lsl" or "unix", "text": with a place for the number}

A numeric stream has in each channel the number of the sample plus 1000 times that of the channel,
or, with ``"waves": true``, sines for a picture; a stream of text ``entry N``, twice a second.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

STEP_S = 0.02
TEXT_HZ = 2.0


class _Stream:
    def __init__(self, wanted: dict[str, Any]) -> None:
        self._wanted = wanted
        self._is_text = wanted.get("format") == "string"
        self._rate = TEXT_HZ if self._is_text else wanted.get("rate") or 10.0
        self._channels = wanted.get("channels", 1)
        self._outlet = pylsl.StreamOutlet(self._info())
        self._begun = pylsl.local_clock()
        self._count = 0

    def push(self) -> None:
        """Push what is due."""
        now = pylsl.local_clock()
        begin, end = self._count, int((now - self._begun) * self._rate)
        self._count = end
        if begin == end or self._is_gap(now - self._begun):
            return
        if self._is_text:
            text = self._wanted.get("text", "entry {}").format(end)
            self._outlet.push_sample([text] * self._channels)
            return
        numbers: NDArray[Any] = np.arange(begin, end)
        stamps = self._begun + (numbers + 1) / self._rate
        if self._wanted.get("stamps") == "unix":
            stamps += time.time() - now
        values = np.empty((len(numbers), self._channels), np.float32)
        for channel in range(self._channels):
            values[:, channel] = self._values(numbers, channel)
        self._outlet.push_chunk(values, stamps.tolist())

    def _values(self, numbers: NDArray[Any], channel: int) -> NDArray[Any]:
        if not self._wanted.get("waves"):
            return numbers + 1000 * channel
        return 40 * channel + 15 * np.sin(numbers / self._rate * (9 + channel))

    def _is_gap(self, elapsed_s: float) -> bool:
        every_s = self._wanted.get("gap_every_s")
        return bool(every_s) and elapsed_s % every_s > every_s - self._wanted["gap_s"]

    def _info(self) -> pylsl.StreamInfo:
        wanted = self._wanted
        info = pylsl.StreamInfo(
            wanted["name"],
            wanted.get("type", "EEG"),
            self._channels,
            wanted.get("rate", 0.0),
            wanted.get("format", "float32"),
            wanted.get("source_id", wanted["name"]),
        )
        channels = info.desc().append_child("channels")
        for number in range(self._channels):
            channel = channels.append_child("channel")
            channel.append_child_value("label", wanted.get("label", "C{}").format(number + 1))
            channel.append_child_value("unit", wanted.get("unit", "microvolts"))
        if wanted.get("header_bytes"):
            info.desc().append_child_value("padding", "x" * wanted["header_bytes"])
        return info


def main() -> None:
    """Stream until ended."""
    streams = [_Stream(wanted) for wanted in json.loads(sys.argv[1])]
    print("ready", flush=True)
    while True:
        time.sleep(STEP_S)
        for stream in streams:
            stream.push()


if __name__ == "__main__":
    main()
