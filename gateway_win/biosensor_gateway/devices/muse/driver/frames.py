"""Parses the frames of an Athena; no I/O and no clock.

A frame consists of its length, a 16-bit counter, the device's clock in milliseconds (48 bits), and
blocks. A block consists of a tag, a counter of the blocks of this tag, a signed 24-bit offset, and
its samples. Everything is little-endian and packed from the lowest bit on. A notification contains
complete frames.

All bytes of 22 recordings [1]_ match this: the counters have no gaps, and the clock, which
continues between recordings, agrees with the host's to 120 ppm. Programs that read a 256 kHz clock
in bytes 2 to 5 [2]_ actually see the upper half of the counter and milliseconds of this clock. The
offset of the first block is relative to the clock, those of the others to the first block, in
microseconds. With this interpretation, timestamps of acceleration never step back, and all others
by less than 1 ms.

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
    """Kind of a block: the lower half of its tag; the upper half is a code of its rate."""

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
# Latest valid time since 1970, below the limit of a `DeviceClock`.
_LATEST_S = 9e10
_WEIGHTS = 2.0 ** np.arange(_LIGHT_BITS)
# Battery block of newer firmware; according to other programs it extends to the frame's end.
_LONG_BATTERY = 0x88


class Block(NamedTuple):
    """Samples of one kind."""

    kind: Kind
    number: int  # Counter of the blocks of its kind, modulo `NUMBERS`.
    stamp_s: float  # Device time at which it was completed.
    payload: bytes


class Frame(NamedTuple):
    """One frame."""

    counter: int  # Frame counter, modulo `COUNTERS`.
    blocks: Sequence[Block]
    unread_bytes: int  # Number of bytes after the last valid block.


def parse_notification(data: bytes) -> tuple[list[Frame], int]:
    """Parse the frames of a notification; return them and the number of invalid bytes."""
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
    """Return samples of TP9, AF7, AF8, TP10, and of four more inputs if present [uV].

    Here and below, all blocks have the same kind and there is at least one.
    """
    counts = _unpacked(_joined(blocks), _EEG_BITS).reshape(-1, _CHANNELS[blocks[0].kind])
    return (counts - EEG_ZERO).astype(np.float64) * EEG_UV


def light(blocks: Sequence[Block]) -> Floats:
    """Return samples of 4, 8 or 16 light channels [20-bit counts]."""
    counts = _unpacked(_joined(blocks), _LIGHT_BITS).reshape(-1, _CHANNELS[blocks[0].kind])
    return counts.astype(np.float64)


def motion(blocks: Sequence[Block]) -> tuple[Floats, Floats]:
    """Return samples of acceleration [g] and rotation [deg/s].

    The signs of rotation axes are as in the programs named above.
    """
    counts = np.frombuffer(_joined(blocks), "<i2").reshape(-1, 6)
    return counts[:, :3] * ACC_G, counts[:, 3:] * -GYRO_DPS


def charge_counts(block: Block) -> int:
    """Return the battery level in 1/256 percent or, according to some programs, 1/512 percent."""
    return int.from_bytes(block.payload[:2], "little")


def _frame(data: bytes) -> Frame:
    number = int.from_bytes(data[1:3], "little")
    clock_s = int.from_bytes(data[3:9], "little") / 1000
    if clock_s >= _LATEST_S:
        return Frame(number, [], len(data) - _HEADER_BYTES)
    return Frame(number, *_walk(data, clock_s))


def _walk(data: bytes, clock_s: float) -> tuple[list[Block], int]:
    """Return the blocks and the number of bytes left over."""
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
    """Return the size of a block's samples in bytes; None if the tag is invalid."""
    kind = tag & 0xF
    if kind not in _BYTES or _BYTES[Kind(kind)] > len(rest):
        return None
    size = _BYTES[Kind(kind)]
    if tag == _LONG_BATTERY and not _are_blocks(rest[size:]):
        return len(rest)
    return size


def _are_blocks(data: bytes) -> bool:
    """Whether bytes consist exactly of blocks, by their tags and lengths."""
    at = 0
    while at < len(data):
        kind = data[at] & 0xF
        if kind not in _BYTES:
            return False
        at += _BLOCK_HEADER_BYTES + _BYTES[Kind(kind)]
    return at == len(data)


def _joined(blocks: Sequence[Block]) -> bytes:
    # The samples of a block fill its bytes completely.
    return b"".join(block.payload for block in blocks)


def _unpacked(payload: bytes, width: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    bits = np.unpackbits(np.frombuffer(payload, np.uint8), bitorder="little")
    # Floats are exact here, and their matrix product is faster.
    values = bits.reshape(-1, width).astype(np.float64) @ _WEIGHTS[:width]
    return values.astype(np.int64)
