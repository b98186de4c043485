"""Compares what the capture agent counted with what a recording holds.

Once a second the agent's ``counters`` stream says, by source_id, how many samples
were pushed and lost since the agent began, and the stamp of the newest one. So
between two of these readings the file must hold as many samples as were pushed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from biosensor_common.refusals import LATELY_S

# At its stop the recorder loses what came in the last 0.5 s, and some devices send
# what they measured only after a second or two.
TAIL_S = 3.0
# Text keeps every digit of a stamp, but a recorder may compute one again.
_SAME_STAMP_S = 1e-6


class Reading(NamedTuple):
    """What the agent had counted of one stream at one moment, by the agent's clock `told_at`.

    `refused` are sentences about what was not passed on as it came.
    """

    pushed: int
    lost: int
    last_stamp: float
    is_off: bool = False
    told_at: float = math.nan
    refused: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedCounters:
    """The agent's counters of one stream against its recording.

    Attributes
    ----------
    pushed
        Samples that the agent pushed between the compared readings.
    held
        Samples of the same time in the file.
    lost
        Samples that the agent counted as lost before LSL while it was recorded.
    restarts
        How often the agent began to count again.
    is_off
        The settings or the model of the device have no such data.
    """

    pushed: int
    held: int
    lost: int
    restarts: int = 0
    is_off: bool = False


def parse_readings(
    texts: Iterable[str], times: Iterable[float] = ()
) -> tuple[dict[str, list[Reading]], int]:
    """Read the samples of a counters stream, and their stamps where they are given.

    Returns
    -------
    dict
        Readings by source_id, in the order of the file.
    int
        Number of samples that could not be read.
    """
    readings: dict[str, list[Reading]] = {}
    unreadable = 0
    for text, told_at in zip(texts, chain(times, repeat(math.nan)), strict=False):
        try:
            entries = _entries(text)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            unreadable += 1
            continue
        for source_id, reading in entries.items():
            readings.setdefault(source_id, []).append(reading._replace(told_at=float(told_at)))
    return readings, unreadable


def _entries(text: str) -> dict[str, Reading]:
    content = cast("Mapping[str, Mapping[str, Any]]", json.loads(text))
    entries = {
        source_id: Reading(
            int(entry["pushed"]),
            int(entry["lost"]),
            float(entry["last_stamp"]),
            entry.get("off") is True,
            refused=tuple(str(each) for each in entry.get("refused", ())),
        )
        for source_id, entry in content.items()
    }
    if not all(np.isfinite(reading.last_stamp) for reading in entries.values()):
        raise ValueError("a stamp is no number")
    return entries


def compare(
    readings: Sequence[Reading], stamps: NDArray[np.float64], end: float
) -> RecordedCounters:
    """Compare the readings of one stream with its stamps.

    Compared is from the first reading that the recording of the stream reaches to the
    last one that it had to reach.

    Parameters
    ----------
    readings
        In the order of the file, at least one.
    stamps : ndarray, shape (n_samples,)
        All stamps of the stream on its own clock.
    end
        When the last reading was taken, on the same clock; of the `TAIL_S` before,
        nothing needs to be in the file.
    """
    ordered = np.sort(stamps[np.isfinite(stamps)])
    runs = _runs(readings)
    parts = [_compare_run(run, ordered, end - TAIL_S) for run in runs]
    return RecordedCounters(
        pushed=sum(part.pushed for part in parts),
        held=sum(part.held for part in parts),
        lost=sum(part.lost for part in parts),
        restarts=len(runs) - 1,
        is_off=readings[-1].is_off,
    )


def refusals(readings: Sequence[Reading]) -> list[str]:
    """Return the newest sentence of each kind about what was not passed on as it came.

    What the first reading has is of the time before, unless it stays.
    """
    first = readings[0]
    earlier = {each for each in first.refused if not _stays(each, readings)}
    told = (each for reading in readings for each in reading.refused)
    return newest_of_each_kind(each for each in told if each not in earlier)


def newest_of_each_kind(sentences: Iterable[str]) -> list[str]:
    """Return the last one of those that differ in nothing but numbers, which grow."""
    return list({re.sub(r"[0-9.]+", "", each): each for each in sentences}.values())


def _stays(sentence: str, readings: Sequence[Reading]) -> bool:
    begin = readings[0].told_at
    return any(sentence in e.refused and e.told_at - begin > LATELY_S for e in readings)


def _runs(readings: Sequence[Reading]) -> list[list[Reading]]:
    """Cut where the agent was started again."""
    runs: list[list[Reading]] = [[]]
    for reading in readings:
        before = runs[-1][-1] if runs[-1] else reading
        if reading.pushed < before.pushed or reading.lost < before.lost:
            runs.append([])
        runs[-1].append(reading)
    return runs


def _compare_run(
    run: Sequence[Reading], stamps: NDArray[np.float64], tail_begin: float
) -> RecordedCounters:
    lost = run[-1].lost - run[0].lost
    # Nothing recorded at all: the first reading is the only beginning there is.
    first, last = (stamps[0], stamps[-1]) if len(stamps) else (-np.inf, -np.inf)
    reached = [reading for reading in run if reading.last_stamp >= first - _SAME_STAMP_S]
    # Some devices tell of a beat six seconds later: what was told of in the tail may be older.
    while reached and reached[-1].last_stamp > last + _SAME_STAMP_S:
        if not (reached[-1].last_stamp > tail_begin or reached[-1].told_at > tail_begin):
            break
        reached.pop()
    if not reached:
        return RecordedCounters(0, 0, lost)
    begin, end = reached[0], reached[-1]
    pushed = end.pushed - begin.pushed
    begin_least, begin_most = _up_to(begin, stamps)
    end_least, end_most = _up_to(end, stamps)
    held = max(end_least - begin_most, min(pushed, end_most - begin_least))
    return RecordedCounters(pushed, held, lost)


def _up_to(reading: Reading, stamps: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many samples of the file had been pushed at a reading, at least and at most.

    Events that happened at one moment have one stamp, and a reading may come between them.
    """
    around = np.array([-_SAME_STAMP_S, _SAME_STAMP_S]) + reading.last_stamp
    earlier, most = np.searchsorted(stamps, around, side="right").tolist()
    return min(earlier + 1, most), most
