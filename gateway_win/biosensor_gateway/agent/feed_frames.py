"""Frames of the agent's feed, for sender and receiver.

A client of the control channel asks for ``feed`` (see `control`), reads the line of the answer,
and then frames until it disconnects::

    length    uint32, little-endian: bytes of the content
    kind      uint8
    content

``STATUS`` is the JSON of the status file, once a second. ``SAMPLES`` are samples that one stream
has just sent::

    n_name    uint16, bytes of the name
    n         uint32, samples
    channels  uint16, 0 for text
    name      source_id, UTF-8
    stamps    n float64, LSL times in seconds
    values    n x channels float32, in the units of the declaration

``DROPPED`` is a uint32: the number of samples that were left out at this point, because the client
did not read in time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    # The page starts without numpy, which takes a fifth of a second.
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

HEAD = struct.Struct("<IB")
_COUNT = struct.Struct("<I")
_SAMPLES = struct.Struct("<HIH")


class FrameKind(IntEnum):
    """The kinds of frames."""

    STATUS = 1
    SAMPLES = 2
    DROPPED = 3


class Samples(NamedTuple):
    """Samples of one stream.

    Attributes
    ----------
    stamps : shape (n,)
        LSL times in seconds.
    values : shape (n, n_channels)
        In the units of the declaration; without channels for text.
    """

    source_id: str
    stamps: NDArray[np.float64]
    values: NDArray[np.float32]


def frame(kind: FrameKind, content: bytes) -> bytes:
    """Encode a frame."""
    return HEAD.pack(len(content), kind) + content


def dropped_frame(count: int) -> bytes:
    """Encode the number of samples that were left out."""
    return frame(FrameKind.DROPPED, _COUNT.pack(min(count, 0xFFFFFFFF)))


def read_count(content: bytes) -> int:
    """Decode the content of a ``DROPPED`` frame.

    Raises
    ------
    ValueError
        If it is not a uint32.
    """
    try:
        return int(_COUNT.unpack(content)[0])
    except struct.error as error:
        raise ValueError(str(error)) from error


def samples_frame(source_id: str, stamps: Sequence[float], values: ArrayLike) -> bytes:
    """Encode samples.

    Parameters
    ----------
    stamps : length n
    values : array_like, shape (n, n_channels), (n,), or empty for text
    """
    import numpy as np  # noqa: PLC0415 - see above

    name = source_id.encode()
    rows: NDArray[Any] = np.asarray(values, dtype="<f4").reshape(len(stamps), -1)
    head = _SAMPLES.pack(len(name), len(stamps), rows.shape[1])
    times = np.asarray(stamps, dtype="<f8")
    return frame(FrameKind.SAMPLES, b"".join((head, name, times.tobytes(), rows.tobytes())))


def read_samples(content: bytes) -> Samples:
    """Decode the content of a ``SAMPLES`` frame.

    Raises
    ------
    ValueError
        If it is not valid.
    """
    import numpy as np  # noqa: PLC0415 - see above

    try:
        n_name, n, channels = _SAMPLES.unpack_from(content)
        end = _SAMPLES.size + n_name
        stamps = np.frombuffer(content, "<f8", n, end)
        values = np.frombuffer(content, "<f4", n * channels, end + stamps.nbytes)
        name = content[_SAMPLES.size : end].decode()
    except struct.error as error:
        raise ValueError(str(error)) from error
    return Samples(name, stamps, values.reshape(n, channels))
