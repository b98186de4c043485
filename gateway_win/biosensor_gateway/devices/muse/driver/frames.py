"""Frames of an Athena; no I/O and no clock.

A frame is its length, a counter of 16 bits, the device's clock in milliseconds of 48 bits, then
blocks; a block is a tag, a number that counts the blocks of its tag, an offset of 24 bits with
sign, and its samples, all little-endian and packed from the lowest bit on. A notification holds
whole frames.

In 22 recordings [1]_ every byte fits this: counters and numbers have no gap, and the clock, which
goes on between recordings, keeps up with the host's to 120 ppm. Programs that read a clock of
256 kHz in bytes 2 to 5 [2]_ see the upper half of the counter and milliseconds of the same clock.
The offset of the first block is that to the clock, those of the others to the first block, in
microseconds: so the stamps of acceleration never turn back, and all others by less than 1 ms.

.. [1] OpenMuse, `tests/test_data`.
.. [2] OpenMuse, `decode.py`. Layouts of blocks and their units: the same, muse-lsl `athena.py`,
   BrainFlow `muse_athena.cpp`; the header as the package openble-muse reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.muse.driver.protocol import ACC_G, GYRO_DPS, Floats

COUNTERS, NUMBERS = 1 << 16, 1 << 8
_HEADER_BYTES, _BLOCK_HEADER_BYTES = 9, 5
EEG_UV = 1450 / 16383
EEG_ZERO = 1 << 13
_EEG_BITS, _LIGHT_BITS = 14, 20


class Kind(IntEnum):
    """What a block holds: the lower half of its tag; the upper half is a code of its rate."""

    EEG4 = 1
    EEG8 = 2
    REFERENCE = 3
    LIGHT4 = 4
    LIGHT8 = 5
    LIGHT16 = 6
    MOTION = 7
    BATTERY = 8


_BYTES = {
    Kind.EEG4: 28,
    Kind.EEG8: 28,
    Kind.REFERENCE: 24,
    Kind.LIGHT4: 30,
    Kind.LIGHT8: 40,
    Kind.LIGHT16: 40,
    Kind.MOTION: 36,
    Kind.BATTERY: 20,
}
_CHANNELS = {Kind.EEG4: 4, Kind.EEG8: 8, Kind.LIGHT4: 4, Kind.LIGHT8: 8, Kind.LIGHT16: 16}
_LATEST_S = 9e10
"""Since 1970; later, it is no time: below what a `DeviceClock` takes."""
_WEIGHTS = 2.0 ** np.arange(_LIGHT_BITS)
_LONG_BATTERY = 0x88
"""Of newer firmware: others found it to last until the end of its frame."""


class Block(NamedTuple):
    """Samples of one kind.

    Attributes
    ----------
    number
        Counts the blocks of its kind, modulo `NUMBERS`.
    stamp_s
        The device's clock when it was handed on.
    """

    kind: Kind
    number: int
    stamp_s: float
    payload: bytes


class Frame(NamedTuple):
    """One frame.

    Attributes
    ----------
    counter
        Counts frames, modulo `COUNTERS`.
    unread_bytes
        What follows the last block that makes sense.
    """

    counter: int
    blocks: Sequence[Block]
    unread_bytes: int


def parse_notification(data: bytes) -> tuple[list[Frame], int]:
    """Read the frames of a notification; return them, and how many bytes make no sense."""
    frames: list[Frame] = []
    at = 0
    while at < len(data):
        length = data[at]
        if length < _HEADER_BYTES + _BLOCK_HEADER_BYTES or at + length > len(data):
            break
        frames.append(_frame(data[at : at + length]))
        at += length
    return frames, len(data) - at + sum(each.unread_bytes for each in frames)


def eeg_uv(blocks: Sequence[Block]) -> Floats:
    """Return samples of TP9, AF7, AF8, TP10, and of four more inputs if there are eight [uV].

    Here and below, the blocks are of one kind, one at least.
    """
    counts = _unpacked(_joined(blocks), _EEG_BITS).reshape(-1, _CHANNELS[blocks[0].kind])
    return (counts - EEG_ZERO).astype(np.float64) * EEG_UV


def light(blocks: Sequence[Block]) -> Floats:
    """Return samples of 4, 8 or 16 photodiodes and wavelengths [counts of 20 bits]."""
    counts = _unpacked(_joined(blocks), _LIGHT_BITS).reshape(-1, _CHANNELS[blocks[0].kind])
    return counts.astype(np.float64)


def motion(blocks: Sequence[Block]) -> tuple[Floats, Floats]:
    """Return samples of acceleration [g] and rotation [deg/s].

    The axes of rotation are turned, as in the programs named above.
    """
    counts = np.frombuffer(_joined(blocks), "<i2").reshape(-1, 6)
    return counts[:, :3] * ACC_G, counts[:, 3:] * -GYRO_DPS


def charge_counts(block: Block) -> int:
    """Return the battery's state of charge, in 256ths of a percent or, some say, 512ths."""
    return int.from_bytes(block.payload[:2], "little")


def _frame(data: bytes) -> Frame:
    number = int.from_bytes(data[1:3], "little")
    clock_s = int.from_bytes(data[3:9], "little") / 1000
    if clock_s >= _LATEST_S:
        return Frame(number, [], len(data) - _HEADER_BYTES)
    return Frame(number, *_walk(data, clock_s))


def _walk(data: bytes, clock_s: float) -> tuple[list[Block], int]:
    """Return the blocks, and how many bytes are left over."""
    blocks: list[Block] = []
    at = _HEADER_BYTES
    while at + _BLOCK_HEADER_BYTES <= len(data):
        tag = data[at]
        size = _size(tag, data[at + _BLOCK_HEADER_BYTES :])
        if size is None:
            break
        offset_s = int.from_bytes(data[at + 2 : at + 5], "little", signed=True) / 1e6
        begin = at + _BLOCK_HEADER_BYTES
        stamp_s = clock_s + offset_s
        if not blocks:
            clock_s = stamp_s
        blocks.append(Block(Kind(tag & 0xF), data[at + 1], stamp_s, data[begin : begin + size]))
        at = begin + size
    return blocks, len(data) - at


def _size(tag: int, rest: bytes) -> int | None:
    """Return how long a block's samples are, None if it is none."""
    kind = tag & 0xF
    if kind not in _BYTES or _BYTES[Kind(kind)] > len(rest):
        return None
    size = _BYTES[Kind(kind)]
    if tag == _LONG_BATTERY and not _are_blocks(rest[size:]):
        return len(rest)
    return size


def _are_blocks(data: bytes) -> bool:
    """Tell whether bytes are blocks and nothing else, by their tags and lengths."""
    at = 0
    while at < len(data):
        kind = data[at] & 0xF
        if kind not in _BYTES:
            return False
        at += _BLOCK_HEADER_BYTES + _BYTES[Kind(kind)]
    return at == len(data)


def _joined(blocks: Sequence[Block]) -> bytes:
    # Samples of a block fill its bytes to the last bit.
    return b"".join(block.payload for block in blocks)


def _unpacked(payload: bytes, width: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    bits = np.unpackbits(np.frombuffer(payload, np.uint8), bitorder="little")
    # Exact in floats, whose product is the fast one.
    values = bits.reshape(-1, width).astype(np.float64) @ _WEIGHTS[:width]
    return values.astype(np.int64)
