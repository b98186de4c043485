"""Compares what the capture agent counted with what a recording holds.

Once a second the agent's ``counters`` stream reports, by source_id, how many samples were pushed
and lost since the agent started, and the timestamp of the newest one. So between two of these
readings the file must contain as many samples as were pushed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from biosensor_common.refusal import LATELY_S
from biosensor_gateway.recording.xdf.figures import Course

# When the recorder stops it loses the samples of the last 0.5 s, and some devices send their
# samples a second or two late.
TAIL_S = 3.0
# The text has every digit of a timestamp, but a recorder may compute omitted ones from the rate.
_SAME_STAMP_S = 1e-6
NEAR_S = 1e-4
STRANGE_READINGS = 4
STRANGE_SAMPLES = (
    "its samples are not those that its agent counted: the recorder continued with another "
    "agent's stream with the same source_id, whose data may be another person's"
)


class Reading(NamedTuple):
    """The agent's counts for one stream at one moment, `told_at` on the agent's clock.

    `refused` are sentences about data that was not passed on unchanged; `run` grows when the agent
    counts from 0 again.
    """

    pushed: int
    lost: int
    last_stamp: float
    is_off: bool = False
    told_at: float = math.nan
    refused: tuple[str, ...] = ()
    run: int = 0
    lacking: tuple[str, ...] = ()


# Numbers, but not those in names, and what differs between one sample and several.
_NUMBERS = re.compile(r"(?<![\w.])[0-9][0-9.]*(?![\w-])|\b(?:is|are|was|were)\b|(?<=\w)s\b")


@dataclass(frozen=True, slots=True)
class RecordedCounters:
    """The agent's counters of one stream, compared with its recording."""

    pushed: int  # Samples that the agent pushed between the readings compared.
    held: int  # Samples in the file in the same time.
    lost: int  # Samples lost before they reached LSL during the recording, as counted by the agent.
    restarts: int = 0  # How often the agent restarted its counts.
    # The stream is switched off in the settings, or the device's model does not have it.
    is_off: bool = False
    # Time on the stream's clock from which its samples are not those that the agent counted; None
    # if they are.
    strange_since: float | None = None
    lacking: tuple[str, ...] = ()  # Labels of channels that the device's model does not have.


def parse_readings(
    texts: Iterable[str], times: Iterable[float] = ()
) -> tuple[dict[str, list[Reading]], int]:
    """Parse the samples of a counters stream, with their timestamps if given.

    Returns
    -------
    dict
        Readings by source_id, in the order of the file.
    int
        Number of samples that could not be parsed.
    """
    readings: dict[str, list[Reading]] = {}
    unreadable = 0
    for text, told_at in zip(texts, chain(times, repeat(math.nan)), strict=False):
        try:
            entries = _entries(text)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            unreadable += 1
            continue
        before = {each: readings[each][-1] for each in entries if each in readings}
        again = [each for each in before if _counts_again(before[each], entries[each])]
        # Of a restarted agent, what is sent seldom may have been sent as often again.
        others = [each for each in before if _is_sent_again(before[each], entries[each])]
        have_begun = before if 2 * len({*again, *others}) > len(before) and again else again
        for source_id, reading in entries.items():
            run = before[source_id].run + (source_id in have_begun) if source_id in before else 0
            told = reading._replace(told_at=float(told_at), run=run)
            readings.setdefault(source_id, []).append(told)
    return readings, unreadable


def _counts_again(before: Reading, now: Reading) -> bool:
    return now.pushed < before.pushed or now.lost < before.lost


def _is_sent_again(before: Reading, now: Reading) -> bool:
    return now.pushed == before.pushed and now.last_stamp != before.last_stamp


def _entries(text: str) -> dict[str, Reading]:
    content = cast("Mapping[str, Mapping[str, Any]]", json.loads(text))
    entries = {
        source_id: Reading(
            int(entry["pushed"]),
            int(entry["lost"]),
            float(entry["last_stamp"]),
            entry.get("off") is True,
            refused=tuple(str(each) for each in entry.get("refused", ())),
            lacking=tuple(str(each) for each in entry.get("lacking", ())),
        )
        for source_id, entry in content.items()
    }
    if not all(np.isfinite(reading.last_stamp) for reading in entries.values()):
        raise ValueError("a timestamp is not a number")
    return entries


def compare(
    readings: Sequence[Reading],
    stamps: NDArray[np.float64] | Callable[[], Iterable[NDArray[np.float64]]],
    end: float,
) -> RecordedCounters:
    """Compare the readings of one stream with its timestamps.

    Compares the time between the first reading that the recording of the stream covers and the
    last reading that it should cover.

    Parameters
    ----------
    readings
        In the order of the file, at least one.
    stamps : ndarray, shape (n_samples,), or callable
        All timestamps of the stream on its own clock, or what gives them in parts.
    end
        When the last reading was taken, on the same clock; samples of the last `TAIL_S` may be
        missing from the file.
    """
    parts = stamps if callable(stamps) else lambda: [stamps]
    runs = _runs(readings)
    # Without recorded samples, the comparison starts at the first reading.
    course = Course.of(parts())
    first, last = (course.first, course.last) if course.count else (-math.inf, -math.inf)
    ends = [_ends(run, first, last, end - TAIL_S) for run in runs]
    told = [each.last_stamp for pair in ends if pair is not None for each in pair]
    strangers = _Strangers(readings)
    up_to = _up_to(np.array(told), map(strangers.watched, parts()))
    compared = [_compare_run(pair, up_to) for pair in ends if pair is not None]
    return RecordedCounters(
        pushed=sum(pushed for pushed, _ in compared),
        held=sum(held for _, held in compared),
        lost=sum(run[-1].lost - run[0].lost for run in runs),
        restarts=len(runs) - 1,
        is_off=readings[-1].is_off,
        strange_since=strangers.since,
        lacking=readings[-1].lacking,
    )


class _Strangers:
    """Finds where a stream's samples do not agree with the readings.

    The newest timestamp of each reading must be among those of the stream. A recorder that went on
    with another stream of the same source_id has as many samples, at other times.
    """

    def __init__(self, readings: Sequence[Reading]) -> None:
        told = {each.last_stamp for each in readings if each.pushed}
        self._told = np.array(sorted(told), np.float64)
        self._is_there = np.zeros(len(told), bool)
        # By how much the number of samples up to each timestamp grows at it.
        self._growth = np.zeros(len(told) + 1, np.int64)
        self._count = 0

    def watched(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Process the next timestamps of the stream, and return them unchanged."""
        ordered = np.sort(stamps[np.isfinite(stamps)])
        self._count += len(ordered)
        if len(ordered) and len(self._told):
            places = np.searchsorted(self._told, ordered)
            np.add.at(self._growth, places, 1)
            begin, end = np.searchsorted(self._told, ordered[[0, -1]] + [-NEAR_S, NEAR_S])
            near = self._told[begin:end]
            at = np.searchsorted(ordered, near)
            before = ordered[np.maximum(at - 1, 0)]
            behind = ordered[np.minimum(at, len(ordered) - 1)]
            off_s = np.minimum(np.abs(near - before), np.abs(behind - near))
            self._is_there[begin:end] |= off_s <= NEAR_S
        return stamps

    @property
    def since(self) -> float | None:
        """The first of several consecutive missing timestamps, among others that are present."""
        up_to = np.cumsum(self._growth[:-1])
        # Where nothing was recorded, samples are lost, and not strange.
        is_amid = (np.diff(up_to, prepend=0) > 0) & (up_to > 0) & (up_to < self._count)
        in_a_row = 0
        for number, is_strange in enumerate((is_amid & ~self._is_there).tolist()):
            in_a_row = in_a_row + 1 if is_strange else 0
            if in_a_row == STRANGE_READINGS:
                return float(self._told[number + 1 - STRANGE_READINGS])
        return None


def refusals(readings: Sequence[Reading]) -> list[str]:
    """Return the newest sentence of each kind about data that was not passed on unchanged.

    Sentences of the first reading are about the time before the recording, unless later readings
    repeat them.
    """
    first = readings[0]
    earlier = {each for each in first.refused if not _stays(each, readings)}
    told = (each for reading in readings for each in reading.refused)
    return newest_of_each_kind(each for each in told if each not in earlier)


def newest_of_each_kind(sentences: Iterable[str]) -> list[str]:
    """Return the last of the sentences that differ only in their numbers, which grow."""
    return list({_NUMBERS.sub("", each): each for each in sentences}.values())


def _stays(sentence: str, readings: Sequence[Reading]) -> bool:
    begin = readings[0].told_at
    return any(sentence in e.refused and e.told_at - begin > LATELY_S for e in readings)


def _runs(readings: Sequence[Reading]) -> list[list[Reading]]:
    """Split the readings where the agent was restarted."""
    runs: list[list[Reading]] = [[]]
    for reading in readings:
        before = runs[-1][-1] if runs[-1] else reading
        if reading.run != before.run or _counts_again(before, reading):
            runs.append([])
        runs[-1].append(reading)
    return runs


def _ends(
    run: Sequence[Reading], first: float, last: float, tail_begin: float
) -> tuple[Reading, Reading] | None:
    """Return the readings between which a run is compared; None if there are none."""
    reached = [reading for reading in run if reading.last_stamp >= first - _SAME_STAMP_S]
    # Some devices report a beat up to six seconds late, so samples counted in the tail may be
    # older than the tail.
    while reached and reached[-1].last_stamp > last + _SAME_STAMP_S:
        if not (reached[-1].last_stamp > tail_begin or reached[-1].told_at > tail_begin):
            break
        reached.pop()
    return (reached[0], reached[-1]) if reached else None


def _compare_run(
    ends: tuple[Reading, Reading], up_to: Mapping[float, tuple[int, int]]
) -> tuple[int, int]:
    """Return how many samples were pushed and are held between two readings."""
    begin, end = ends
    pushed = end.pushed - begin.pushed
    begin_least, begin_most = up_to[begin.last_stamp]
    end_least, end_most = up_to[end.last_stamp]
    return pushed, max(end_least - begin_most, min(pushed, end_most - begin_least))


def _up_to(
    told: NDArray[np.float64], parts: Iterable[NDArray[np.float64]]
) -> Mapping[float, tuple[int, int]]:
    """Return the minimum and maximum number of the file's samples pushed before readings."""
    # Simultaneous events share a timestamp, and a reading may be taken between them.
    around = told[:, np.newaxis] + np.array([-_SAME_STAMP_S, _SAME_STAMP_S])
    counts = np.zeros(around.shape, np.int64)
    for stamps in parts:
        counts += np.searchsorted(np.sort(stamps[np.isfinite(stamps)]), around, side="right")
    return {
        float(stamp): (min(int(earlier) + 1, int(most)), int(most))
        for stamp, (earlier, most) in zip(told, counts, strict=True)
    }
