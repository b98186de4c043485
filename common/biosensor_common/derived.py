"""Says in a stream's header that it was computed from another one."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

BLOCK = "features"
"""The element of ``desc`` that tells a stream of a feature from one that was measured."""
MAX_SOURCE_CHARACTERS = 512


@dataclass(frozen=True, slots=True)
class Derived:
    """Where a feature comes from, and how long a value of it is one of now.

    Attributes
    ----------
    source_id
        Of the stream that it was computed from.
    holds_s
        So many seconds after its stamp a value is not that of now any more.
    """

    source_id: str
    holds_s: float


def read_derived(root: ET.Element) -> Derived | None:
    """Read a full description; None if it tells of no feature, or of one without these facts."""
    block = root.find(f"desc/{BLOCK}")
    if block is None:
        return None
    source_id = block.findtext("source_id") or ""
    try:
        holds_s = float(block.findtext("holds_s") or "")
    except ValueError:
        return None
    is_usable = 0 < len(source_id) <= MAX_SOURCE_CHARACTERS and 0 < holds_s < math.inf
    return Derived(source_id, holds_s) if is_usable else None
