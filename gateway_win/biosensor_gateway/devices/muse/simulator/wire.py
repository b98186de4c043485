"""Characteristics, commands and answers of headbands of all generations.

Sources: muse-lsl (`constants.py`, `muse.py`), muse-js (`muse-utils.ts`) and OpenMuse (`muse.py`)
for UUIDs, framing and the fields of answers.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

SERVICE = "fe8d"
_BASE = "273e{:04x}-4c4d-454d-96be-f03bac821358"
_PIECE_BYTES = 20


def uuid(number: int) -> str:
    """Return the UUID of a characteristic by the part that differs."""
    return _BASE.format(number)


CONTROL = uuid(0x0001)


def command_text(written: bytes) -> str | None:
    """Return the command in what a host wrote, None if it is none."""
    if len(written) < 2 or written[0] != len(written) - 1 or written[-1:] != b"\n":
        return None
    return written[1:-1].decode("ascii", "replace")


def pieces(
    answers: Iterable[Mapping[str, object]], cuts: np.random.Generator | None = None
) -> Iterator[bytes]:
    """Cut answers into notifications: a count, so many characters, zeros.

    Parameters
    ----------
    answers
        One behind the other.
    cuts
        Makes pieces of any length; None fills them.
    """
    text = b"".join(json.dumps(each, separators=(",", ":")).encode("ascii") for each in answers)
    room = _PIECE_BYTES - 1
    while text:
        length = room if cuts is None else int(cuts.integers(1, room, endpoint=True))
        piece, text = text[:length], text[length:]
        yield bytes((len(piece),)) + piece.ljust(room, b"\0")


def version(firmware: str, protocol: int) -> dict[str, object]:
    """Return what a headband says of its firmware."""
    return {
        "ap": "headset",
        "sp": "RevE",
        "tp": "consumer",
        "hw": "3.1",
        "bn": 27,
        "fw": firmware,
        "bl": "1.2.3",
        "pv": protocol,
        "rc": 0,
    }


def status(name: str, serial: str, percent: float, preset: str) -> dict[str, object]:
    """Return what a headband says of its state."""
    return {
        "hn": name,
        "sn": serial,
        "ma": "00-55-da-b0-3a-1f",
        "id": "06473435 32313630 00280034",
        "bp": round(percent, 2),
        "ts": 0,
        "ps": int(preset[1:], 16),
        "rc": 0,
    }
