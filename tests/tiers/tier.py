"""The tier of a test, by its marks."""

from __future__ import annotations

import re
from enum import StrEnum

import pytest

_MARK_OF_A_FILE = re.compile(r"^pytestmark = .*?$(?:\n    .*$)*", re.MULTILINE)
_MARKS = {"seam": "seams", "nightly": "nightly", "system": "nightly", "alone": "nightly"}


class Tier(StrEnum):
    """What a test may use, and when it runs; see tests/README.md."""

    UNIT = "unit"
    SEAMS = "seams"
    NIGHTLY = "nightly"


def tier_of(item: pytest.Item) -> Tier:
    """Return the tier of a test: *unit* unless a mark says otherwise.

    A test's own mark counts before that of its file, and that of a parameter before both.
    """
    for node in reversed(item.listchain()):
        tiers = [_MARKS[mark.name] for mark in node.own_markers if mark.name in _MARKS]
        if tiers:
            return Tier(tiers[-1])
    return Tier.UNIT


def is_in_memory(item: pytest.Item) -> bool:
    """Tell whether a test's links are in memory, and its time is virtual.

    They are in unit tests, and in those that are only too long for that.
    """
    return tier_of(item) is Tier.UNIT or item.get_closest_marker("in_memory") is not None


def may_hold(text: str, tier: Tier) -> bool:
    """Tell from a file's text whether it may have tests of a tier, without importing it."""
    if tier is Tier.UNIT:
        of_file = _MARK_OF_A_FILE.search(text)
        return of_file is None or not any(f"mark.{mark}" in of_file[0] for mark in _MARKS)
    # A parameter of a fixture elsewhere may make any test a nightly one.
    return tier is Tier.NIGHTLY or "mark.seam" in text or "SEAM_" in text
