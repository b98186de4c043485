"""Delta compression of PMD frames.

A reference sample of whole bytes per channel, then blocks of ``bits | count |
payload``: `count` samples of one difference per channel, each `bits` wide, packed
from the lowest bit on and filled up to a whole byte.
"""

from __future__ import annotations

from collections.abc import Iterator

Sample = tuple[int, ...]

MAX_BITS = 32
"""No difference of two 24-bit values is wider."""


def expand(data: bytes, channels: int, resolution_bits: int) -> list[Sample] | None:
    """Return the samples of a compressed frame; None if it is cut short or damaged.

    Parameters
    ----------
    data
        All behind the frame's header.
    channels
    resolution_bits
        Of the reference sample.

    Returns
    -------
    list of tuple of int
        One value a channel; up to 255 samples for every two bytes.
    """
    width = -(-resolution_bits // 8)
    position = width * channels
    if len(data) < position:
        return None
    sample = tuple(
        int.from_bytes(data[at : at + width], "little", signed=True)
        for at in range(0, position, width)
    )
    samples = [sample]
    while position < len(data):
        header = data[position : position + 2]
        if len(header) < 2 or header[0] > MAX_BITS:
            return None
        bits, count = header
        end = position + 2 + -(-bits * count * channels // 8)
        if end > len(data):
            return None
        for deltas in _deltas(data[position + 2 : end], bits, count, channels):
            sample = tuple(value + delta for value, delta in zip(sample, deltas, strict=True))
            samples.append(sample)
        position = end
    return samples


def _deltas(payload: bytes, bits: int, count: int, channels: int) -> Iterator[list[int]]:
    number = int.from_bytes(payload, "little")
    mask, sign = (1 << bits) - 1, (1 << bits) >> 1
    for first in range(0, count * channels, channels):
        fields = [number >> (index * bits) & mask for index in range(first, first + channels)]
        # Flipping the sign bit and taking it off again extends the sign; no bits are a zero.
        yield [(field ^ sign) - sign for field in fields]
