"""Keeps some lines at the bottom of a terminal, and renews them in place below the log.

Only cursor movements that every terminal with a cursor has are used: ECMA-48 CUU, ED and EL.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.cells import cell_len, set_cell_size

from biosensor_common.outflow import Outflow
from biosensor_gateway.system.console_lines import on_one_line

_TO_START, _UP = "\r", "\x1b[{}A"
_CLEAR_LINE, _CLEAR_BELOW = "\x1b[K", "\x1b[J"
_NORMAL = "\x1b[0m"


class Size(NamedTuple):
    """Of a terminal, in characters."""

    columns: int
    lines: int


class Line(NamedTuple):
    """A line of a panel, with the ECMA-48 sequence of its colour; empty for none."""

    text: str
    colour: str = ""


Render = Callable[[Size], Sequence[Line]]
"""Makes the lines for a terminal of that size."""


class Panel:
    """Draws in the thread of a terminal's outflow, so that nobody waits for the terminal.

    While the terminal takes nothing, pictures are left out, each as a whole.

    Parameters
    ----------
    outflow
        The terminal's; all that is written to the terminal must come this way.
    size
        Tells how large the terminal is; None while it must not be drawn on, because another
        program has it or it has gone.
    encoding
        Of the terminal.
    """

    def __init__(
        self, outflow: Outflow, size: Callable[[], Size | None], encoding: str = "utf-8"
    ) -> None:
        self._outflow, self._size, self._encoding = outflow, size, encoding
        self._render: Render = lambda _size: ()
        self._is_closed = False
        self._drawn: tuple[int, ...] = ()
        self._unfinished = b""
        outflow.shape = self.shape

    def show(self, render: Render) -> None:
        """Show this from now on; never waits."""
        self._render = render
        self._outflow.put_if_idle(b"")

    def close(self, last_line: str = "") -> None:
        """Take the panel away once all before that is written; what is shown later counts not."""
        if not self._is_closed:
            self._is_closed = True
            self._outflow.put(self._encoded(f"{last_line}\n" if last_line else ""))

    def shape(self, lines: bytes) -> bytes:
        """Return what writes lines above the panel, and the panel anew."""
        whole = self._whole_lines(lines)
        size = self._size()
        if size is None:
            # Whoever has the terminal now does not know of the panel.
            self._drawn = ()
            return whole
        start = self._start(size)
        if self._outflow.is_behind and whole:
            # It is drawn again behind the last of many.
            self._drawn = ()
            return self._encoded(start + (_CLEAR_BELOW if start else "")) + whole
        wanted = self._fitting(size)
        picture = "".join(f"{_coloured(line)}{_CLEAR_LINE}\r\n" for line in wanted)
        clear = _CLEAR_BELOW if start else ""
        self._drawn = tuple(cell_len(line.text) for line in wanted)
        if whole:
            return self._encoded(start + clear) + whole + self._encoded(picture)
        return self._encoded(start + picture + clear)

    def _whole_lines(self, lines: bytes) -> bytes:
        """Keep a line back until its end has come, or the next picture is due."""
        come = self._unfinished + lines
        if not lines and come:
            self._unfinished = b""
            return come + b"\n"
        whole, _, self._unfinished = come.rpartition(b"\n")
        return whole + b"\n" if whole or come[:1] == b"\n" else b""

    def _start(self, size: Size) -> str:
        """Go to where the panel begins."""
        # A terminal that was made narrower has broken wider lines, or has cut them: the old
        # panel stays, because lines of the log above it must not be taken for a part of it.
        if not self._drawn or max(self._drawn) > size.columns:
            return ""
        return _TO_START + _UP.format(len(self._drawn))

    def _fitting(self, size: Size) -> list[Line]:
        # The cursor stands below the last line, and above what has gone it cannot go.
        if self._is_closed or size.lines < 2 or size.columns < 2:
            return []
        lines = list(self._render(size))[: size.lines - 1]
        # What ends in the last column is broken by some terminals.
        return [self._cut(line, size.columns - 1) for line in lines]

    def _cut(self, line: Line, room: int) -> Line:
        # An escape for a letter that the terminal has not got is longer than the letter.
        text = self._encoded(on_one_line(line.text)).decode(self._encoding)
        return line._replace(text=text if cell_len(text) <= room else set_cell_size(text, room))

    def _encoded(self, text: str) -> bytes:
        return text.encode(self._encoding, "backslashreplace")


def _coloured(line: Line) -> str:
    return f"{line.colour}{line.text}{_NORMAL}" if line.colour else line.text
