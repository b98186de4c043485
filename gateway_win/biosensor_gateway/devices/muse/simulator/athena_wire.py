"""Frames of a Muse S Athena as it writes them.

Sources: recordings of OpenMuse for the frame, with 16 bits of counter and 48 bits of
milliseconds as the package openble-muse reads them; OpenMuse (`decode.py`) and BrainFlow
(`muse_athena.cpp`) for tags, lengths, packing and scales of blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.muse.simulator.wire import uuid
from biosensor_gateway.simulation.wearer import Floats

DATA_UUIDS = (uuid(0x13), uuid(0x14))
EEG4, EEG8, LIGHT4, LIGHT8, LIGHT16 = 0x11, 0x12, 0x34, 0x35, 0x36
MOTION, REFERENCE, BATTERY = 0x47, 0x53, 0x98
SAMPLES = {EEG4: 4, EEG8: 2, LIGHT4: 3, LIGHT8: 2, LIGHT16: 1, MOTION: 3, REFERENCE: 6, BATTERY: 1}
WIDTHS = {EEG4: 4, EEG8: 8, LIGHT4: 4, LIGHT8: 8, LIGHT16: 16}
LONGEST_FRAME = 230
HEADER_BYTES, BLOCK_HEADER_BYTES = 9, 5
_UV, _G, _DPS = 1450 / 16383, 1 / 16384, -245 / 32768


class Block(NamedTuple):
    """A block of one frame.

    Attributes
    ----------
    stamp_us
        The device's clock when it was handed on.
    """

    tag: int
    number: int
    stamp_us: int
    payload: bytes

    @property
    def length(self) -> int:
        """In bytes, with its header."""
        return BLOCK_HEADER_BYTES + len(self.payload)


def frame(counter: int, blocks: Sequence[Block]) -> bytes:
    """Return a frame of blocks: milliseconds of the first one, its rest, and distances to it."""
    first_us = blocks[0].stamp_us
    offsets = [first_us % 1000, *(each.stamp_us - first_us for each in blocks[1:])]
    body = b"".join(
        bytes((block.tag, block.number & 0xFF)) + offset.to_bytes(3, "little", signed=True)
        + block.payload
        for block, offset in zip(blocks, offsets, strict=True)
    )  # fmt: skip
    clock = (counter & 0xFFFF).to_bytes(2, "little") + (first_us // 1000).to_bytes(6, "little")
    return bytes((1 + len(clock) + len(body),)) + clock + body


def eeg(microvolts: Floats) -> tuple[bytes, Floats]:
    """Return samples of 4 or 8 electrodes, and the values that they hold [uV]."""
    counts = np.clip(np.rint(microvolts / _UV) + 8192, 0, (1 << 14) - 1).astype(int)
    return _packed(counts, 14), (counts - 8192) * _UV


def light(values: Floats) -> tuple[bytes, Floats]:
    """Return samples of light, and the values that they hold [counts]."""
    counts = np.clip(np.rint(values), 0, (1 << 20) - 1).astype(int)
    return _packed(counts, 20), counts.astype(float)


def motion(g: Floats, degrees_per_s: Floats) -> tuple[bytes, Floats, Floats]:
    """Return samples of acceleration and rotation, and the values that they hold."""
    units = np.array([_G] * 3 + [_DPS] * 3)
    counts = np.rint(np.concatenate((g, degrees_per_s), axis=1) / units)
    raw = np.clip(counts, -32768, 32767).astype("<i2")
    held = raw * units
    return raw.tobytes(), held[:, :3], held[:, 3:]


def charge(percent: float) -> tuple[bytes, float]:
    """Return the battery's state of charge, and the percentage that it holds.

    Of a full one, a headband was seen to say 100.5 %.
    """
    raw = 25728 if percent >= 100 else round(percent * 256)
    return raw.to_bytes(2, "little") + bytes(18), min(100.0, raw / 256)


def _packed(counts: np.ndarray[tuple[int, ...], np.dtype[np.int64]], width: int) -> bytes:
    """Pack values one after the other, each from its lowest bit on."""
    bits = 0
    for place, count in enumerate(counts.reshape(-1)):
        bits |= int(count) << (width * place)
    return bits.to_bytes((width * counts.size + 7) // 8, "little")
