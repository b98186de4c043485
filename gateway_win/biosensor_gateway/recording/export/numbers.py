"""Formats many numbers at once, with the shortest text that reads back as the same number.

numpy and Python take half a microsecond per number, and a recording of two hours has a hundred
million. pydantic's serialiser writes a list of floats ten times as fast, as the shortest decimals
that give the same float64. For a float32 it would write the 17 digits of the equal float64, of
which only the first few are significant. So each float32 is first replaced by the float64 nearest
to its own shortest decimal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

# Any decimal of 6 digits survives conversion to float32; 9 digits distinguish all float32.
_LEAST_DIGITS, _MOST_DIGITS = 6, 9
# Powers of ten up to this are exact in float64, so a quotient is rounded only once.
_EXACT_POWER = 22
_POWERS = 10.0 ** np.arange(_EXACT_POWER + 1)


def rows_of_numbers(times: NDArray[np.float64], values: NDArray[Any]) -> bytes:
    """Return a line for each sample: its time or times and its values, separated by commas.

    Parameters
    ----------
    times : ndarray of float64, shape (n_samples,) or (n_samples, n_times)
    values : ndarray of a float or integer type, shape (n_samples, n_channels)

    Returns
    -------
    bytes
        Each line ends in LF. Special values are ``NaN``, ``inf`` and ``-inf``.
    """
    if values.dtype.kind == "f":
        rows: list[Any] = np.column_stack((times, tidied(values))).tolist()
    else:
        # float64 cannot represent all 64-bit integers.
        lead = times.reshape(len(times), -1).T.tolist()
        rows = list(zip(*lead, *values.T.tolist(), strict=True))
    return _text(rows, values)[2:-2].replace(b"],[", b"\n") + b"\n"


def numbers(values: NDArray[Any]) -> list[bytes]:
    """Return the text of each value, row by row.

    Parameters
    ----------
    values : ndarray of a float or integer type, of any shape
    """
    flat = (tidied(values) if values.dtype.kind == "f" else values).ravel()
    return _text(flat.tolist(), values)[1:-1].split(b",") if flat.size else []


def tidied(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return float64 numbers whose shortest decimals are those of the values.

    Parameters
    ----------
    values : ndarray of float32 or float64, of any shape
        float64 values are returned unchanged.
    """
    wide = np.asarray(values, np.float64)
    if values.dtype.itemsize == wide.dtype.itemsize:
        return wide
    narrow, flat = values.ravel(), wide.ravel()
    tidy = flat.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        exponents = np.floor(np.log10(np.abs(flat)))
        # Zero, NaN, infinity, and numbers beyond exact powers of ten keep all their digits.
        is_near = np.abs(exponents) <= _EXACT_POWER - _MOST_DIGITS
    left = np.flatnonzero(is_near)
    for digits in range(_LEAST_DIGITS, _MOST_DIGITS + 1):
        decimals = digits - 1 - exponents[left].astype(np.int64)
        candidates = _rounded(flat[left], decimals)
        is_same = candidates.astype(np.float32) == narrow[left]
        tidy[left[is_same]] = candidates[is_same]
        left = left[~is_same]
        if not len(left):
            break
    return tidy.reshape(values.shape)


def _rounded(values: NDArray[np.float64], decimals: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the float64 nearest to each value rounded to a number of decimals, even negative."""
    up, down = _POWERS[np.maximum(decimals, 0)], _POWERS[np.maximum(-decimals, 0)]
    return np.rint(values / down * up) / up * down


def _text(content: list[Any], values: NDArray[Any]) -> bytes:
    text = to_json(content, inf_nan_mode="constants")
    is_plain = values.dtype.kind != "f" or bool(np.isfinite(values).all())
    return text if is_plain else text.replace(b"Infinity", b"inf")
