"""Wraps lines to the width of the terminal."""

from __future__ import annotations

import shutil
import textwrap
from typing import TextIO


def columns(output: TextIO) -> int | None:
    """Return how wide the terminal behind an output is; None where there is none."""
    return shutil.get_terminal_size().columns if output.isatty() else None


def wrapped(text: str, width: int | None, hang: int = 0) -> str:
    """Break a line between words.

    Parameters
    ----------
    width
        Of the terminal; None leaves the line as it is.
    hang
        How far all lines but the first are indented.
    """
    if width is None or len(text) <= width:
        return text
    # A path or an address that is longer than the line stays whole.
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
    """Return a name, or its two ends where it is too long."""
    if len(text) <= width:
        return text
    head = (width - 3) // 2
    return f"{text[:head]}...{text[len(text) - (width - 3 - head) :]}"
