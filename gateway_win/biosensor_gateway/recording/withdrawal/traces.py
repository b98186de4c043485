"""Traces of a person in files: names, and pieces of their data by which these are found again."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.numbers import numbers, rows_of_numbers
from biosensor_gateway.settings.names import label

INSTEAD = "withdrawn"
"""Stands where a text of others names the person."""
_SAMPLES = 8
_FEWEST_VALUES = 4
_MOST_PIECES = 400


class Person:
    """Who withdraws, by the names that files have for them.

    Parameters
    ----------
    name
        As the recordings have it.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        names = "|".join(re.escape(each) for each in dict.fromkeys([name, label(name)]))
        pattern = rf"(?<![0-9A-Za-z])(?:{names})(?![0-9A-Za-z])"
        # In another case it is another name for a computer, and the same for a reader.
        self._text = re.compile(pattern, re.IGNORECASE)
        self._bytes = re.compile(pattern.encode(), re.IGNORECASE)

    def is_called(self, participant: str) -> bool:
        """Whether a participant is this person."""
        return bool(participant) and label(participant).lower() == label(self.name).lower()

    def is_in(self, text: str) -> bool:
        """Whether a text names them."""
        return self._text.search(text) is not None

    def is_in_bytes(self, content: bytes) -> bool:
        """Whether bytes name them."""
        return self._bytes.search(content) is not None

    def places(self, content: bytes) -> Iterator[tuple[int, int]]:
        """Give where in bytes the name is, from its first to behind its last."""
        return (each.span() for each in self._bytes.finditer(content))

    def blanked(self, content: bytes) -> bytes:
        """Return bytes with as many other letters in place of the name."""
        return self._bytes.sub(lambda found: b"x" * len(found[0]), content)

    def masked(self, text: str) -> str:
        """Return a text without the name."""
        return self._text.sub(INSTEAD, text)

    def pruned(self, content: object) -> object:
        """Return what JSON holds without all that is theirs; None if nothing is left.

        An object that says it is of the participant goes as a whole, and so does each key and each
        text of a list that names them; other texts are masked.
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
    """Pieces of the data that were taken out, in the forms in which files hold them."""

    found: list[bytes] = field(default_factory=list[bytes])

    def take(self, samples: Samples) -> None:
        """Take in some samples of a stream of numbers."""
        if len(self.found) >= _MOST_PIECES or isinstance(samples.values, list):
            return
        values = samples.values[:_SAMPLES]
        if len(values) < _SAMPLES or len(np.unique(values)) < _FEWEST_VALUES:
            return
        self.found += _forms(samples, values)

    def in_bytes(self, content: bytes) -> bool:
        """Whether one of them is in bytes."""
        return any(each in content for each in self.found)

    @property
    def longest(self) -> int:
        """Bytes of the longest."""
        return max(map(len, self.found), default=0)


def _forms(samples: Samples, values: np.ndarray[Any, Any]) -> Iterator[bytes]:
    yield values.tobytes()
    if values.dtype != np.float64:
        yield values.astype("<f8").tobytes()
    line = rows_of_numbers(samples.times[:1], values[:1])
    # A line of one short number may be anybody's.
    if len(line) > 16:
        yield line.strip()
    if values.shape[1] == 1:
        yield b"\n".join(numbers(values))


def blocks(parts: Iterable[bytes], overlap: int) -> Iterator[bytes]:
    """Join what follows each other by so many bytes, so that nothing is missed at a border."""
    rest = b""
    for part in parts:
        block = rest + part
        yield block
        rest = block[-overlap:] if overlap else b""
