"""Deals out what happened to the files of a stream's runs."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple

Happened = tuple[float, str]
"""Time on the recorder's clock, in s, and text."""


class Span(NamedTuple):
    """Of the file of one run, in s on the recorder's clock; the end is excluded."""

    begin_s: float
    end_s: float


def dealt(happened: Sequence[Happened], spans: Sequence[Span]) -> tuple[list[list[Happened]], int]:
    """Return what stands in each file, and how much of it happened outside of all of them.

    That stands in the file before, or in the first one: an annotation may be of any time.

    Parameters
    ----------
    happened
        In the order of time.
    spans
        Of at least one file, in any order.
    """
    found: list[list[Happened]] = []
    is_outside = [True] * len(happened)
    for span in spans:
        inside = range(
            bisect_left(happened, (span.begin_s, "")), bisect_left(happened, (span.end_s, ""))
        )
        found.append([happened[place] for place in inside])
        for place in inside:
            is_outside[place] = False
    outside = [each for each, it_is in zip(happened, is_outside, strict=True) if it_is]
    begins = sorted((span.begin_s, number) for number, span in enumerate(spans))
    for each in outside:
        place = bisect_right(begins, (each[0], len(spans)))
        found[begins[max(0, place - 1)][1]].append(each)
    return found, len(outside)
