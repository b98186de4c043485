"""Traces of a person in files: names, and pieces of data to search for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.tables import numbers, rows_of_numbers
from biosensor_gateway.settings.names import label

INSTEAD = "withdrawn"
"""Replaces the person's name in texts about others."""
_SAMPLES = 8
_FEWEST_VALUES = 4
_MOST_PIECES = 400


class Person:
    """The withdrawing person, with all forms of the name in files.

    Parameters
    ----------
    name
        As in the recordings.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        names = "|".join(re.escape(each) for each in dict.fromkeys([name, label(name)]))
        pattern = rf"(?<![0-9A-Za-z])(?:{names})(?![0-9A-Za-z])"
        # Case is ignored, because a reader recognises the name in any case.
        self._text = re.compile(pattern, re.IGNORECASE)
        self._bytes = re.compile(pattern.encode(), re.IGNORECASE)

    def is_called(self, participant: str) -> bool:
        """Whether a participant is this person."""
        return bool(participant) and label(participant).lower() == label(self.name).lower()

    def is_in(self, text: str) -> bool:
        """Whether a text contains the name."""
        return self._text.search(text) is not None

    def is_in_bytes(self, content: bytes) -> bool:
        """Whether bytes contain the name."""
        return self._bytes.search(content) is not None

    def places(self, content: bytes) -> Iterator[tuple[int, int]]:
        """Yield the range of each occurrence of the name, with the end excluded."""
        return (each.span() for each in self._bytes.finditer(content))

    def blanked(self, content: bytes) -> bytes:
        """Return bytes with each letter of the name replaced by an x."""
        return self._bytes.sub(lambda found: b"x" * len(found[0]), content)

    def masked(self, text: str) -> str:
        """Return a text with the name replaced."""
        return self._text.sub(INSTEAD, text)

    def pruned(self, content: object) -> object:
        """Return JSON content without the person's data; None if nothing is left.

        Objects of the participant are removed completely, as are keys and list items that contain
        the name; in other texts the name is replaced.
        """
        if isinstance(content, dict):
            told = cast("dict[str, object]", content)
            if any(self.is_called(str(told.get(key, ""))) for key in ("participant", "wearer")):
                return None
            kept = {key: self.pruned(each) for key, each in told.items() if not self.is_in(key)}
            return {
                key: each for key, each in kept.items() if each is not None or told[key] is None
            }
        if isinstance(content, list):
            pruned = [
                self.pruned(each)
                for each in cast("list[object]", content)
                if not (isinstance(each, str) and self.is_in(each))
            ]
            return [each for each in pruned if each is not None]
        return self.masked(content) if isinstance(content, str) else content


@dataclass(slots=True)
class Pieces:
    """Pieces of the removed data, in the forms in which files may contain them."""

    found: list[bytes] = field(default_factory=list[bytes])

    def take(self, samples: Samples) -> None:
        """Add pieces from some samples of a numeric stream."""
        if len(self.found) >= _MOST_PIECES or isinstance(samples.values, list):
            return
        values = samples.values[:_SAMPLES]
        if len(values) < _SAMPLES or len(np.unique(values)) < _FEWEST_VALUES:
            return
        self.found += _forms(samples, values)

    def in_bytes(self, content: bytes) -> bool:
        """Whether bytes contain one of them."""
        return any(each in content for each in self.found)

    @property
    def longest(self) -> int:
        """Length of the longest piece in bytes."""
        return max(map(len, self.found), default=0)


def _forms(samples: Samples, values: np.ndarray[Any, Any]) -> Iterator[bytes]:
    yield values.tobytes()
    if values.dtype != np.float64:
        yield values.astype("<f8").tobytes()
    line = rows_of_numbers(samples.times[:1], values[:1])
    # A short line, such as a single number, could be in anyone's data.
    if len(line) > 16:
        yield line.strip()
    if values.shape[1] == 1:
        yield b"\n".join(numbers(values))


def blocks(parts: Iterable[bytes], overlap: int) -> Iterator[bytes]:
    """Yield parts with the last `overlap` bytes before them, to find matches across borders."""
    rest = b""
    for part in parts:
        block = rest + part
        yield block
        rest = block[-overlap:] if overlap else b""
