"""Understands what LabRecorder's program prints, and says which streams it is to find.

Facts from App-LabRecorder's ``LabRecorderCLI.cpp`` and ``recording.cpp``: it looks for streams
for one second, prints a line for each that fits, and ends with code 2 if none does. Then it
opens them in threads of their own; whatever they print may share a line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from biosensor_common.lsl.predicates import Predicate, all_of, any_of, equals
from biosensor_gateway.recording.receiving import NOTE
from biosensor_gateway.recording.recorder.streams import VisibleStream

_FOUND, _MATCHING = "Found ", " matching '"
_READY, _BEGUN = "Starting the recording", "Started data collection for stream "
_MOST_SAID = 300


class Said:
    """What it has printed so far."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._found = [
            line[len(_FOUND) : line.rfind(_MATCHING)]
            for line in text.splitlines()
            if line.startswith(_FOUND)
        ]

    @property
    def has_looked(self) -> bool:
        """Whether it looks for no more streams."""
        return _READY in self._text

    @property
    def records(self) -> bool:
        """Whether all that it found are open, so that nothing of them is missed from now on."""
        return self.has_looked and self._text.count(_BEGUN) >= len(self._found)

    def missed(self, wanted: Iterable[VisibleStream]) -> tuple[VisibleStream, ...]:
        """Return those of the wanted streams that it has not found."""
        left = Counter(self._found)
        missed: list[VisibleStream] = []
        for stream in wanted:
            key = f"{stream.name}@{stream.host}"
            if left[key] > 0:
                left[key] -= 1
            else:
                missed.append(stream)
        return tuple(missed)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the own recorder wants a person to know of its recording."""
        lines = self._text.splitlines()
        return tuple(each.removeprefix(NOTE) for each in lines if each.startswith(NOTE))

    @property
    def end(self) -> str:
        """Its last words, for a sentence."""
        # With another library of C++ than its own it was seen to print memory between its words.
        text = "".join(each for each in self._text if each.isprintable() or each.isspace())
        words = " / ".join(line.strip() for line in text.splitlines() if line.strip())
        return words[-_MOST_SAID:] or "nothing"


def predicate(streams: Sequence[VisibleStream]) -> Predicate:
    """Return what finds these streams and no others."""
    ids = (equals("source_id", each.source_id) for each in streams)
    names = (equals("name", each.name) for each in streams)
    return any_of(*map(all_of, ids, names))
