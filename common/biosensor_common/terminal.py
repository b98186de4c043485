"""Wraps lines to the width of the terminal."""

from __future__ import annotations

import shutil
import textwrap
from typing import TextIO


def columns(output: TextIO) -> int | None:
    """Return the width of an output's terminal; None if it is not a terminal."""
    return shutil.get_terminal_size().columns if output.isatty() else None


def wrapped(text: str, width: int | None, hang: int = 0) -> str:
    """Break a line between words.

    Parameters
    ----------
    width
        Width of the terminal; None leaves the line unchanged.
    hang
        Indentation of all lines but the first.
    """
    if width is None or len(text) <= width:
        return text
    # A path or URL that is longer than the line is not broken, so that it can be copied.
    return textwrap.fill(
        text,
        width,
        subsequent_indent=" " * hang,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
        drop_whitespace=True,
    )


def shortened(text: str, width: int) -> str:
    """Return a name; one that is too long loses its middle."""
    if len(text) <= width:
        return text
    head = (width - 3) // 2
    return f"{text[:head]}...{text[len(text) - (width - 3 - head) :]}"
