"""Delta compression of PMD frames.

A reference sample in full, then blocks: bits of a difference, count of samples, and the
differences to the sample before, least significant bit first, channel by channel. Each
block starts at a byte's border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

_BLOCK_SAMPLES = 12


def compress(samples: Integers, resolution: int, block_samples: int = _BLOCK_SAMPLES) -> bytes:
    """Encode samples.

    Parameters
    ----------
    samples : ndarray of int64, shape (n, channels)
        At least one.
    resolution
        Bits of a sample.
    block_samples
        So many samples share one width; at most 255.
    """
    reference = little_endian(samples[:1], -(-resolution // 8))
    differences = np.diff(samples, axis=0)
    starts = range(0, len(differences), block_samples)
    return reference + b"".join(block(differences[at : at + block_samples]) for at in starts)


def block(differences: Integers, bits: int | None = None) -> bytes:
    """Encode one block with so many bits a difference; as many as it needs by default."""
    bits = _width(differences) if bits is None else bits
    unsigned = differences.reshape(-1, 1) & ((1 << bits) - 1)
    stream = (unsigned >> np.arange(bits)) & 1
    payload = np.packbits(stream.astype(np.uint8).ravel(), bitorder="little")
    return bytes((bits, len(differences))) + payload.tobytes()


def little_endian(values: Integers, size: int) -> bytes:
    """Write signed integers of so many bytes each."""
    eight = np.ascontiguousarray(values, dtype="<i8").view(np.uint8).reshape(-1, 8)
    return eight[:, :size].tobytes()


def _width(differences: Integers) -> int:
    """Bits that hold every difference with its sign."""
    magnitude = np.where(differences < 0, ~differences, differences)
    return int(magnitude.max(initial=0)).bit_length() + 1
