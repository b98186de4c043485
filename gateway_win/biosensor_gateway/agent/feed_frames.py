"""What the agent's feed is made of, for both of its ends.

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
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

HEAD = struct.Struct("<IB")
_SAMPLES = struct.Struct("<HIH")
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
    source_id
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


def samples_frame(source_id: str, stamps: Sequence[float], values: ArrayLike) -> bytes:
    """Return a frame of samples.

    Parameters
    ----------
    stamps : length n
    values : array_like, shape (n, n_channels), (n,), or empty for text
    """
    name = source_id.encode()
    rows: NDArray[Any] = np.asarray(values, dtype="<f4").reshape(len(stamps), -1)
    head = _SAMPLES.pack(len(name), len(stamps), rows.shape[1])
    times = np.asarray(stamps, dtype="<f8")
    return frame(FrameKind.SAMPLES, b"".join((head, name, times.tobytes(), rows.tobytes())))


def dropped_frame(count: int) -> bytes:
    """Return a frame that says how many samples were left out."""
    return frame(FrameKind.DROPPED, _COUNT.pack(min(count, 0xFFFFFFFF)))


def read_samples(content: bytes) -> Samples:
    """Read the content of a frame of samples.

    Raises
    ------
    ValueError
        It is not one.
    """
    try:
        n_name, n, channels = _SAMPLES.unpack_from(content)
        end = _SAMPLES.size + n_name
        stamps = np.frombuffer(content, "<f8", n, end)
        values = np.frombuffer(content, "<f4", n * channels, end + stamps.nbytes)
        name = content[_SAMPLES.size : end].decode()
    except struct.error as error:
        raise ValueError(str(error)) from error
    return Samples(name, stamps, values.reshape(n, channels))


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
