"""Frames of the agent's feed, for both of its ends.

A client of the control channel asks for ``feed`` (see `control`), reads the line of the answer,
and then frames until it goes away::

    length    uint32, little-endian: bytes of what follows after the kind
    kind      uint8
    content

A ``STATUS`` is the JSON of the status file, once a second. ``SAMPLES`` are what one stream has
just sent::

    n_name    uint16, bytes of the name
    n         uint32, samples
    channels  uint16, 0 for text
    name      source_id, UTF-8
    stamps    n float64, LSL times in seconds
    values    n x channels float32, in the units of the declaration

``DROPPED`` is a uint32: so many samples have been left out just here, because this client did
not read in time.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    # It takes a fifth of a second, and the page begins without it; see `sample_frames`.
    import numpy as np
    from numpy.typing import NDArray

HEAD = struct.Struct("<IB")
_COUNT = struct.Struct("<I")


class FrameKind(IntEnum):
    """What a frame tells."""

    STATUS = 1
    SAMPLES = 2
    DROPPED = 3


class Samples(NamedTuple):
    """What one stream sent.

    Attributes
    ----------
    stamps : shape (n,)
        LSL times in seconds.
    values : shape (n, n_channels)
        In the units of the declaration; of text there are no channels.
    """

    source_id: str
    stamps: NDArray[np.float64]
    values: NDArray[np.float32]


def frame(kind: FrameKind, content: bytes) -> bytes:
    """Return a frame as it is sent."""
    return HEAD.pack(len(content), kind) + content


def dropped_frame(count: int) -> bytes:
    """Return a frame that says how many samples were left out."""
    return frame(FrameKind.DROPPED, _COUNT.pack(min(count, 0xFFFFFFFF)))


def read_count(content: bytes) -> int:
    """Read the content of a frame of what was left out.

    Raises
    ------
    ValueError
        It is not one.
    """
    try:
        return int(_COUNT.unpack(content)[0])
    except struct.error as error:
        raise ValueError(str(error)) from error
