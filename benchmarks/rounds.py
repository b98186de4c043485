"""Rounds in a rotating order, so that a noisy minute hits every leg."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import TypeVar

R = TypeVar("R")


def in_rounds(
    legs: Mapping[str, Callable[[float, float], R]], rounds: int, seconds: float, settle_s: float
) -> dict[str, list[R]]:
    """Run every leg *rounds* times; return the results of each, in the order of time."""
    names = list(legs)
    results: dict[str, list[R]] = {name: [] for name in names}
    for number in range(rounds):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            sys.stderr.write(f"  round {number + 1} of {rounds}: {name}\n")
            results[name].append(legs[name](seconds, settle_s))
    return results
