"""The licence texts that ``installer/bundle/texts`` keeps for what ships none."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import cast

from installer.bundle.model import Text
from installer.bundle.names import normalised

FOLDER = Path(__file__).parent / "texts"
_SOURCES = FOLDER / "sources.toml"


@cache
def _sources() -> dict[str, dict[str, object]]:
    return cast("dict[str, dict[str, object]]", tomllib.loads(_SOURCES.read_text(encoding="utf-8")))


@cache
def generic_identifiers() -> frozenset[str]:
    """Return the SPDX identifiers whose text serves everything under that licence."""
    return frozenset(name for name, entry in _sources().items() if entry.get("generic"))


@cache
def _stems() -> dict[str, str]:
    """Map the normalised name of a component to the name of its text."""
    found: dict[str, str] = {}
    for stem, entry in _sources().items():
        if not entry.get("generic"):
            names = cast("list[str]", entry.get("of", [stem]))
            found |= {normalised(name): stem for name in names}
    return found


def kept_text(component: str) -> Text | None:
    """Return the text that is kept for a component; None if there is none."""
    stem = _stems().get(normalised(component))
    return None if stem is None else common_text(stem)


def common_text(stem: str) -> Text:
    """Return a kept text by its own name."""
    return Text(f"common/{stem}.txt", (FOLDER / f"{stem}.txt").read_bytes())
