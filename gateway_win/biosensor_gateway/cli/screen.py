"""Prints sentences and tables that fit the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from biosensor_common.terminal import columns, shortened, wrapped

# Where there is no terminal, nothing needs to fit.
_ENDLESS = 10_000
_GAP = 2


def console() -> Console:
    """Return the terminal, or what stands in for it and never breaks a line."""
    return Console(width=None if sys.stdout.isatty() else _ENDLESS)


def say(text: str, hang: int = 2) -> None:
    """Print a sentence; on a terminal its lines end between words."""
    typer.echo(wrapped(text, columns(sys.stdout), hang))


def table_of_names(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> Table:
    """Return a table of names and figures that is no wider than this.

    A name, in the first column, goes on in the next line; words of it that still do not
    fit lose their middle. Figures are shown whole.
    """
    sizes = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    left = max(len(headings[0]), width - sum(sizes[1:]) - _GAP * len(sizes))
    table = Table(box=None)
    table.add_column(headings[0], max_width=left)
    for heading, size in zip(headings[1:], sizes[1:], strict=True):
        table.add_column(heading, justify="right", no_wrap=True, min_width=size)
    for name, *figures in rows:
        words = " ".join(shortened(word, left) for word in name.split(" "))
        # Square brackets in a label are no markup.
        table.add_row(escape(words), *figures)
    return table
