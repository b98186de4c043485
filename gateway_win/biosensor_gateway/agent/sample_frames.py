"""Frames of samples, in a separate module because they need numpy; see `feed_frames`."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from biosensor_gateway.agent.feed_frames import FrameKind, Samples, frame

_SAMPLES = struct.Struct("<HIH")


def samples_frame(source_id: str, stamps: Sequence[float], values: ArrayLike) -> bytes:
    """Encode samples.

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


def read_samples(content: bytes) -> Samples:
    """Decode the content of a ``SAMPLES`` frame.

    Raises
    ------
    ValueError
        If it is not valid.
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
