"""Commands to a headband and its answers; no I/O and no clock.

A command is a byte that counts what follows, then ASCII that ends with a line feed. The answer
is a JSON object with a return code ``rc``, 0 for success, in pieces of up to 20 bytes: each
begins with the count of its characters [1]_, in the lower five bits [2]_.

.. [1] muse-js, `muse-utils.ts`, and muse-lsl, `muse.py`.
.. [2] The package openble-muse, `replies.py`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, cast

HALT = "h"
STATUS = "s"
KEEP_ALIVE = "k"
START, START_FRAMES = "d", "dc001"
VERSION, VERSION_OF_FRAMES = "v1", "v6"
"""They offer a version of the protocol: the first one is of headbands before the Athena."""
_LONGEST_BODY = 19
_COUNT_MASK = 0x1F
_LONGEST_ANSWER = 1024
_DECODER = json.JSONDecoder()

Answer = Mapping[str, Any]


def encode(command: str) -> bytes:
    """Return the bytes of a command.

    Raises
    ------
    ValueError
        It is empty, too long or no ASCII.
    """
    body = (command + "\n").encode("ascii")
    if not 1 < len(body) <= _LONGEST_BODY:
        raise ValueError(f"{command!r} is no command: 1 to {_LONGEST_BODY - 1} characters fit")
    return bytes((len(body),)) + body


class Answers:
    """Puts the pieces of answers together, wherever they were cut.

    Attributes
    ----------
    complete
        Answers that a piece ended besides the one that it was asked for.
    """

    def __init__(self) -> None:
        self._text = ""
        self.complete: list[Answer] = []

    def feed(self, piece: bytes) -> Answer | None:
        """Take a piece; return the answer that it ends, None if it ends none.

        A piece may end several: the others are `complete`, until the next piece.
        """
        count = piece[0] & _COUNT_MASK if piece else 0
        self._text += piece[1 : 1 + count].decode("ascii", "replace")
        self.complete = list(self._cut_off())
        return self.complete.pop(0) if self.complete else None

    def _cut_off(self) -> Iterator[Answer]:
        """Return the answers that are whole, and keep what is behind the last one."""
        begin = self._text.find("{")
        while begin >= 0:
            found = _first_of(self._text[begin:])
            # An answer whose end was lost must not spoil the next one.
            begin = self._text.find("{", begin + 1)
            if found is not None:
                answer, rest = found
                self._text = rest
                begin = rest.find("{")
                yield answer
        self._text = self._text[-_LONGEST_ANSWER:]


def text_of(answer: Answer, key: str) -> str:
    """Return a field as printable text, empty if there is none."""
    return "".join(each for each in str(answer.get(key, "")) if each.isprintable())


def return_code(answer: Answer) -> int:
    """Return what an answer says of its command: 0 for success, also where it says nothing."""
    code = answer.get("rc", 0)
    return code if isinstance(code, int) else -1


def battery_percent(answer: Answer) -> float | None:
    """Return what is left in the battery; None where a status does not tell."""
    percent = answer.get("bp")
    if isinstance(percent, bool) or not isinstance(percent, int | float):
        return None
    return float(percent) if 0 <= percent <= 100 else None


def _first_of(text: str) -> tuple[Answer, str] | None:
    """Return the object that a text begins with, and what is behind; None if it is not whole."""
    try:
        found, end = _DECODER.raw_decode(text)
    except (ValueError, RecursionError):
        return None
    return (cast("Answer", found), text[end:]) if isinstance(found, dict) else None
