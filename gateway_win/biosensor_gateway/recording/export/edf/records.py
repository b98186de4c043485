"""Makes data records of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.export.edf.layout import GREATEST, LEAST, Channel

_BYTES = 3


def digital(values: NDArray[Any], channels: Sequence[Channel]) -> NDArray[np.int32]:
    """Return steps of 24 bits; what is no number is the least one.

    Parameters
    ----------
    values : ndarray, shape (n_samples, n_channels_of_the_stream)

    Returns
    -------
    ndarray of int32, shape (n_samples, n_channels)
    """
    picked = np.asarray(values[:, [each.place for each in channels]], np.float64)
    factors, least, steps = np.array([(c.factor, c.least, c.step) for c in channels]).T
    found = np.rint((picked * factors - least) / steps) + LEAST
    found = np.where(np.isfinite(found), found, LEAST)
    return np.asarray(np.clip(found, LEAST, GREATEST), np.int32)


def records(
    pieces: Iterable[NDArray[np.int32]], samples: int, annotations: Sequence[bytes], room: int
) -> Iterator[bytes]:
    """Give bytes of whole data records; the last one is filled up with its last sample.

    Parameters
    ----------
    pieces : iterable of ndarray, shape (n_samples, n_channels)
    samples
        In a record.
    annotations
        Of each record.
    room
        Bytes for them.
    """
    done, rest = 0, None
    for piece in pieces:
        joined = piece if rest is None else np.concatenate((rest, piece))
        whole = len(joined) // samples * samples
        rest = joined[whole:]
        if whole:
            told = annotations[done : done + whole // samples]
            yield _encoded(joined[:whole], samples, told, room)
            done += whole // samples
    if rest is not None and len(rest):
        filled = np.concatenate((rest, np.repeat(rest[-1:], samples - len(rest), axis=0)))
        yield _encoded(filled, samples, annotations[done : done + 1], room)


def _encoded(
    steps: NDArray[np.int32], samples: int, annotations: Sequence[bytes], room: int
) -> bytes:
    count, width = len(annotations), steps.shape[1]
    by_channel = steps.reshape(count, samples, width).transpose(0, 2, 1).astype("<i4", order="C")
    numbers = by_channel.view(np.uint8).reshape(count, -1, 4)[:, :, :_BYTES].reshape(count, -1)
    texts = b"".join(each.ljust(room, b"\0") for each in annotations)
    told = np.frombuffer(texts, np.uint8).reshape(count, room)
    return np.concatenate((numbers, told), axis=1).tobytes()
