"""Names of files and columns, numbers, quoting and compression of all tables of text."""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.exporter import Clock

_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")
_LONGEST_NAME = 80
# Device names, which are reserved on Windows with any suffix.
_OF_WINDOWS = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def unique(names: Iterable[str]) -> list[str]:
    """Return names made unique, ignoring case."""
    taken: set[str] = set()
    found: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate.casefold() in taken:
            candidate, number = f"{name}_{number}", number + 1
        taken.add(candidate.casefold())
        found.append(candidate)
    return found


class FileNames:
    """Creates file names for streams, without suffix, that are valid on any system.

    All names are unique, also between runs and other streams, and even if case is ignored.

    Parameters
    ----------
    reserved
        Names of other files, which streams must not use.
    """

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._taken = {each.casefold() for each in reserved}

    def of(self, stream: Stream, runs: int = 1) -> list[str]:
        """Return a name for each run of a stream."""
        # Many commands would take a leading hyphen as an option.
        plain = _UNSAFE.sub("_", stream.header.name)[:_LONGEST_NAME].strip("._-")
        name = plain or f"stream_{stream.number}"
        if device := _OF_WINDOWS.fullmatch(name):
            # What precedes the first dot counts: nul.txt.csv would be NUL.
            name = f"{device[1]}_{device[2] or ''}"
        candidate, number = name, 2
        while not self._take(names := _of_runs(candidate, runs)):
            candidate, number = f"{name}_{number}", number + 1
        return names[1:] if runs > 1 else names

    def _take(self, names: Iterable[str]) -> bool:
        claimed = {each.casefold() for each in names}
        is_free = self._taken.isdisjoint(claimed)
        if is_free:
            self._taken |= claimed
        return is_free


def _of_runs(name: str, runs: int) -> list[str]:
    """Return the name without a run, which stays reserved, and the names of the runs."""
    return [name] if runs == 1 else [name, *(f"{name}_run{each}" for each in range(1, runs + 1))]


def file_names(streams: Sequence[Stream], reserved: Iterable[str] = ()) -> list[str]:
    """Return a file name for each stream, see `FileNames`."""
    names = FileNames(reserved)
    return [names.of(each)[0] for each in streams]


_TIMES = {Clock.LSL: "lsl_time", Clock.WALL: "unix_time"}
SECONDS = "seconds"
"""Name of the column with times since the start of the export."""
MARKERS = "all_markers.csv"
"""The table with the events of all marker streams."""
# Much faster than the default 6, with hardly larger files.
_GZIP_LEVEL = 4


def time_column(clock: Clock) -> str:
    """Return the name of the column with times in s."""
    return _TIMES[clock]


@contextmanager
def table_file(path: Path, *, is_packed: bool, level: int = _GZIP_LEVEL) -> Generator[BinaryIO]:
    """Open a new file, which is compressed by gzip or not.

    Parameters
    ----------
    level
        gzip level, 1 to 9.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        file: BinaryIO = stack.enter_context(path.open("xb"))
        if is_packed:
            # Without a time and a name, so that equal contents give equal files.
            packing = gzip.GzipFile("", "wb", level, file, mtime=0)
            file = stack.enter_context(packing)  # type: ignore[assignment]
        yield file


def columns(stream: Stream) -> list[str]:
    """Return a column name for each channel."""
    labels = stream.header.labels
    return unique(label.strip() or str(place) for place, label in enumerate(labels, 1))


def own_columns(stream: Stream) -> list[str]:
    """Return column names that differ from those of the time columns."""
    taken = [*_TIMES.values(), SECONDS]
    return unique([*taken, *columns(stream)])[len(taken) :]


def quoted(rows: Iterable[Sequence[str | float]]) -> bytes:
    """Return CSV lines in which texts are quoted and numbers are not."""
    text = io.StringIO(newline="")
    csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n").writerows(rows)
    # pandas and R end a text at a NUL.
    return text.getvalue().replace("\0", " ").encode()


# Any decimal of 6 digits survives conversion to float32; 9 digits distinguish all float32.
_LEAST_DIGITS, _MOST_DIGITS = 6, 9
# Powers of ten up to this are exact in float64, so a quotient is rounded only once.
_EXACT_POWER = 22
_POWERS = 10.0 ** np.arange(_EXACT_POWER + 1)


# numpy and Python take half a microsecond per number, and a recording of two hours has a hundred
# million. pydantic's serialiser writes a list of floats ten times as fast, as the shortest decimals
# that give the same float64. For a float32 it would write the 17 digits of the equal float64, of
# which only the first few are significant. So each float32 is first replaced by the float64 nearest
# to its own shortest decimal.
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
