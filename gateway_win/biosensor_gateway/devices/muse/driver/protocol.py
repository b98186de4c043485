"""Characteristics, commands and answers of headbands, and packets of those before the Athena.

A command is a length byte and ASCII text that ends with a line feed. The answer is a JSON object
with a return code ``rc``, 0 for success, in pieces of up to 20 bytes. Each piece begins with its
number of characters [1]_, in the lower five bits [2]_.

Each characteristic sends packets of 20 bytes: a packet counter and samples of one channel or of
three axes, all big-endian; each characteristic has its own counter [1]_.

.. [1] muse-js, `muse-utils.ts` and `muse-parse.ts`; muse-lsl, `muse.py` and `constants.py`, which
   also have the UUIDs, as BrainFlow has.
.. [2] The package openble-muse, `replies.py`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray


def _uuid(number: int) -> str:
    return f"273e{number:04x}-4c4d-454d-96be-f03bac821358"


SERVICE = "0000fe8d-0000-1000-8000-00805f9b34fb"
CONTROL = _uuid(0x01)
EEG = (_uuid(0x03), _uuid(0x04), _uuid(0x05), _uuid(0x06))
"""TP9, AF7, AF8, TP10."""
AUX = _uuid(0x07)
GYRO, ACC, TELEMETRY = _uuid(0x09), _uuid(0x0A), _uuid(0x0B)
PPG = (_uuid(0x0F), _uuid(0x10), _uuid(0x11))
"""Ambient, infrared, red."""
FRAMES = (_uuid(0x13), _uuid(0x14))
"""Characteristics for all data of an Athena; some firmware only has the first one."""

HALT = "h"
STATUS = "s"
KEEP_ALIVE = "k"
START, START_FRAMES = "d", "dc001"
VERSION, VERSION_OF_FRAMES = "v1", "v6"
"""Commands that select a protocol version; the first one is for headbands before the Athena."""
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
        If it is empty, too long or not ASCII.
    """
    body = (command + "\n").encode("ascii")
    if not 1 < len(body) <= _LONGEST_BODY:
        raise ValueError(
            f"{command!r} is not a command: it can have 1 to {_LONGEST_BODY - 1} characters"
        )
    return bytes((len(body),)) + body


class Answers:
    """Joins the pieces of answers."""

    def __init__(self) -> None:
        self._text = ""
        self.complete: list[Answer] = []  # Further answers completed by the last piece.

    def feed(self, piece: bytes) -> Answer | None:
        """Add a piece; return the answer that it completes, if any.

        If it completes several, the others are in `complete` until the next piece.
        """
        count = piece[0] & _COUNT_MASK if piece else 0
        self._text += piece[1 : 1 + count].decode("ascii", "replace")
        self.complete = list(self._cut_off())
        return self.complete.pop(0) if self.complete else None

    def _cut_off(self) -> Iterator[Answer]:
        """Yield the complete answers, and keep the rest."""
        begin = self._text.find("{")
        while begin >= 0:
            found = _first_of(self._text[begin:])
            # An answer whose end was lost must not corrupt the next one.
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
    """Return the return code of an answer; 0 for success or if it is missing."""
    code = answer.get("rc", 0)
    return code if isinstance(code, int) else -1


def battery_percent(answer: Answer) -> float | None:
    """Return the battery level; None if a status does not contain it."""
    percent = answer.get("bp")
    if isinstance(percent, bool) or not isinstance(percent, int | float):
        return None
    return float(percent) if 0 <= percent <= 100 else None


def _first_of(text: str) -> tuple[Answer, str] | None:
    """Return the JSON object at the start of a text, and the rest; None if incomplete."""
    try:
        found, end = _DECODER.raw_decode(text)
    except (ValueError, RecursionError):
        return None
    return (cast("Answer", found), text[end:]) if isinstance(found, dict) else None


NUMBERS = 1 << 16
_BYTES, _NUMBER_BYTES = 20, 2
EEG_SAMPLES, LIGHT_SAMPLES, MOTION_SAMPLES = 12, 6, 3
EEG_UV = 2000 / 4096
"""Microvolts per count: the range of 12 bits is 2 mV."""
EEG_ZERO = 2048
ACC_G = 1 / 16384
GYRO_DPS = 245 / 32768
"""245 degrees per second in 15 bits: the 0.0074768 of muse-lsl and muse-js."""
CHARGE_PERCENT = 1 / 512

Floats = NDArray[np.float64]

FULLEST_PERCENT = 105
"""A full battery reports a little more than 100."""


class Packet(NamedTuple):
    """One packet.

    Attributes
    ----------
    number
        Packet counter of the characteristic, modulo `NUMBERS`.
    samples : ndarray of float64
        Shape (n,) for a channel, (n, 3) for axes.
    """

    number: int
    samples: Floats


def parse_eeg(data: bytes) -> Packet | None:
    """Parse twelve samples of an electrode [uV]; None if invalid."""
    if len(data) != _BYTES:
        return None
    triples = np.frombuffer(data, np.uint8, offset=_NUMBER_BYTES).reshape(-1, 3).astype(np.int32)
    high = triples[:, 0] << 4 | triples[:, 1] >> 4
    low = (triples[:, 1] & 0xF) << 8 | triples[:, 2]
    counts = np.stack((high, low), axis=1).reshape(-1)
    return Packet(_number(data), (counts - EEG_ZERO).astype(np.float64) * EEG_UV)


def parse_light(data: bytes) -> Packet | None:
    """Parse six samples of a photodiode [24-bit counts]; None if invalid."""
    if len(data) != _BYTES:
        return None
    triples = np.frombuffer(data, np.uint8, offset=_NUMBER_BYTES).reshape(-1, 3).astype(np.int32)
    counts = triples[:, 0] << 16 | triples[:, 1] << 8 | triples[:, 2]
    return Packet(_number(data), counts.astype(np.float64))


def parse_motion(data: bytes, unit: float) -> Packet | None:
    """Parse three samples of X, Y, Z; None if invalid.

    Parameters
    ----------
    unit
        Size of a count: `ACC_G` or `GYRO_DPS`.
    """
    if len(data) != _BYTES:
        return None
    counts = np.frombuffer(data, ">i2", offset=_NUMBER_BYTES).reshape(MOTION_SAMPLES, 3)
    return Packet(_number(data), counts * unit)


def parse_charge(data: bytes) -> float | None:
    """Parse the battery level [percent] in a telemetry packet; None if invalid."""
    if len(data) != _BYTES:
        return None
    percent = int.from_bytes(data[2:4], "big") * CHARGE_PERCENT
    return min(100.0, percent) if percent <= FULLEST_PERCENT else None


def _number(data: bytes) -> int:
    return int.from_bytes(data[:_NUMBER_BYTES], "big")
