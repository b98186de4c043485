"""Writes a stream without a rate, beats for example, as a table of moments."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.bids.tables import NOTHING
from biosensor_gateway.recording.export.csv.tables import table_file
from biosensor_gateway.recording.export.numbers import rows_of_numbers

_MICROSECONDS = 6


def write_irregular(path: Path, batches: Iterator[Samples]) -> int:
    """Write onset, duration and values of each sample, in the order of the recording.

    Parameters
    ----------
    batches
        Times are seconds since zero.

    Returns
    -------
    int
        How many samples these are.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    written = 0
    with table_file(path, is_packed=True) as file:
        for samples in batches:
            file.write(_text(samples.times, np.asarray(samples.values)))
            written += len(samples)
    return written


def _text(times: NDArray[np.float64], values: NDArray[np.generic]) -> bytes:
    text = rows_of_numbers(np.round(times, _MICROSECONDS), values)
    lines = text.replace(b"NaN", NOTHING.encode()).splitlines()
    # A moment has no duration.
    rows = (line.partition(b",") for line in lines)
    return b"".join(onset + b"\t0\t" + rest.replace(b",", b"\t") + b"\n" for onset, _, rest in rows)
