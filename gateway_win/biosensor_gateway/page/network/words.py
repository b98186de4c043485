"""Makes of what strangers send what a person can read and copy."""

from __future__ import annotations

import contextlib
import json
from typing import Any, cast

MAX_NAME = 120
MAX_LABEL = 40
MAX_ENTRY = 200
_TOLD = ("event", "marker", "note", "device", "state", "stream", "reason")


def readable(text: str, most: int = MAX_NAME) -> str:
    r"""Return text without control characters and others that change how the rest is shown.

    They are written as ``\x0a`` or ``\u202e``, so that a name that is copied into a terminal
    does nothing there; what is too long ends in dots.
    """
    shown = "".join(each if each.isprintable() else _escaped(each) for each in text[: most + 1])
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


def entry_of(text: str, *, is_ours: bool) -> str:
    """Return an entry of a stream of text; of an agent's JSON what a person wants to know."""
    if is_ours:
        with contextlib.suppress(ValueError, RecursionError):
            content = json.loads(text)
            if isinstance(content, dict):
                told = cast("dict[str, Any]", content)
                parts = [told[key] for key in _TOLD if isinstance(told.get(key), str)]
                text = ": ".join(parts) or text
    return readable(text, MAX_ENTRY)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
