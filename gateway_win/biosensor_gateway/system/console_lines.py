"""Formats log records as lines for people, and draws a panel below them on a terminal.

A line has local time, device and a sentence. Facts for programs are only in the log file.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from datetime import datetime
from typing import NamedTuple, cast

from rich.cells import cell_len, set_cell_size
from structlog.typing import EventDict, WrappedLogger

from biosensor_common.nonblocking_writer import NonblockingWriter
from biosensor_common.terminal import wrapped

FOR_PEOPLE = "for_people"
"""Key of a record's sentence that a terminal shows instead of the event and its facts."""

# Facts for programs, which only the log file has.
_UNSHOWN = frozenset({"code", "event_name", "reason", "where", "way"})
_DEVICE = frozenset({"sensor", "unit", "participant", "label"})
_EVERYWHERE = _DEVICE | {"event", "level", "logger", "text", "timestamp"}
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_MARKS = {"warning": "!", "error": "!", "critical": "!"}
_COLOURS = {"!": "\x1b[33m"}
_NORMAL = "\x1b[0m"
_HANG = len("hh:mm:ss ! ")


def without_line_for_people(
    _logger: WrappedLogger, _method: str, event_dict: EventDict
) -> EventDict:
    """Remove the sentence that only a terminal shows."""
    event_dict.pop(FOR_PEOPLE, None)
    return event_dict


def on_one_line(text: str) -> str:
    """Escape line ends and control characters."""
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


class LinesForPeople:
    """The last structlog processor for records on a terminal.

    Parameters
    ----------
    title
        Returns a sensor's name for people.
    columns
        Returns the width of the terminal; None to wrap no lines.
    verbose
        Whether to show all facts.
    """

    def __init__(
        self,
        title: Callable[[str], str],
        columns: Callable[[], int | None],
        *,
        colours: bool,
        verbose: bool,
    ) -> None:
        self._title, self._columns = title, columns
        self._colours, self._verbose = colours, verbose

    def __call__(self, _logger: WrappedLogger, _method: str, event_dict: EventDict) -> str:
        """Return the line without its end, wrapped between words."""
        mark = _MARKS.get(str(event_dict.get("level")), " ")
        text = on_one_line(f"{_clock_time(event_dict)} {mark} {self._sentence(event_dict)}")
        text = wrapped(text, self._columns(), _HANG)
        colour = _COLOURS.get(mark, "") if self._colours else ""
        return f"{colour}{text}{_NORMAL}" if colour else text

    def _sentence(self, record: EventDict) -> str:
        said = record.get(FOR_PEOPLE)
        if self._verbose or said is None:
            said = sentence_of(record, verbose=self._verbose)
        said = str(said)
        return f"{self._device(record, said)}{said}"

    def _device(self, record: EventDict, said: str) -> str:
        sensor, unit = str(record.get("sensor", "")), str(record.get("unit", ""))
        title = self._title(sensor) if sensor else ""
        worn = [str(part) for key in ("participant", "label") if (part := record.get(key))]
        if worn:
            return f"{title} {unit} ({' '.join(worn)}): "
        # Many sentences begin with the device's name already.
        name = "" if title and said.startswith(title) else f"{title} {unit}".strip()
        return f"{name}: " if name else ""


def sentence_of(record: Mapping[str, object], *, verbose: bool = False) -> str:
    """Return the event with its facts, without device and time.

    Parameters
    ----------
    record
        A record of the log, also one that was read from its file.
    """
    # A vendor's service can send its own text, which is shown instead of the event.
    event = str(record.get("text") or record.get("event", ""))
    facts = ", ".join(_facts(record, verbose=verbose))
    return f"{event} ({facts})" if facts else event


def _facts(record: Mapping[str, object], *, verbose: bool) -> Iterator[str]:
    if verbose:
        known = _EVERYWHERE | {FOR_PEOPLE}
        yield from (f"{key}={value!r}" for key, value in record.items() if key not in known)
        return
    for key, value in record.items():
        if key in _EVERYWHERE or key in _UNSHOWN or value in (None, False, ""):
            continue
        words = key.replace("_", " ")
        yield words if value is True else f"{words} {_shown(value)}"


def _clock_time(record: Mapping[str, object]) -> str:
    try:
        moment = datetime.fromisoformat(str(record.get("timestamp"))).astimezone()
    except ValueError:
        moment = datetime.now().astimezone()
    return moment.strftime("%H:%M:%S")


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | set | frozenset):
        return " ".join(str(each) for each in cast("list[object]", value))
    return str(value)


_TO_START, _UP = "\r", "\x1b[{}A"
_CLEAR_LINE, _CLEAR_BELOW = "\x1b[K", "\x1b[J"


class Size(NamedTuple):
    """The size of a terminal, in characters."""

    columns: int
    lines: int


class Line(NamedTuple):
    """A line of a panel, with the ECMA-48 sequence of its colour; empty for none."""

    text: str
    colour: str = ""


Render = Callable[[Size], Sequence[Line]]
"""Returns the lines of a panel for a terminal of this size."""


class Panel:
    """Lines below the log that are drawn by the thread of the terminal's writer.

    While the terminal is blocked, drawings are skipped.

    Parameters
    ----------
    writer
        Writer of the terminal, through which all output to it must go.
    size
        Returns the size of the terminal; None while it must not be drawn on, because another
        program has it or it was closed.
    """

    def __init__(
        self, writer: NonblockingWriter, size: Callable[[], Size | None], encoding: str = "utf-8"
    ) -> None:
        self._writer, self._size, self._encoding = writer, size, encoding
        self._render: Render = lambda _size: ()
        self._is_closed = False
        self._drawn: tuple[int, ...] = ()
        self._unfinished = b""
        writer.shape = self.shape

    def show(self, render: Render) -> None:
        """Replace the lines of the panel; never blocks."""
        self._render = render
        self._writer.put_if_idle(b"")

    def close(self, last_line: str = "") -> None:
        """Remove the panel after everything before it is written; later calls have no effect."""
        if not self._is_closed:
            self._is_closed = True
            self._writer.put(self._encoded(f"{last_line}\n" if last_line else ""))

    def shape(self, lines: bytes) -> bytes:
        """Return the bytes that insert log lines above the panel and redraw the panel."""
        whole = self._whole_lines(lines)
        size = self._size()
        if size is None:
            # Another program has the terminal, so that the panel's lines cannot be found again.
            self._drawn = ()
            return whole
        start = self._start(size)
        if self._writer.is_behind and whole:
            # More lines are waiting: the panel is drawn again after the last of them.
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
        """Return complete lines; an unfinished one waits for its end or for the next drawing."""
        received = self._unfinished + lines
        if not lines and received:
            self._unfinished = b""
            return received + b"\n"
        whole, _, self._unfinished = received.rpartition(b"\n")
        return whole + b"\n" if whole or received[:1] == b"\n" else b""

    def _start(self, size: Size) -> str:
        """Return the sequence that moves the cursor to the start of the panel."""
        # In a terminal that was made narrower, wider lines may have been wrapped, so that the
        # start of the old panel is unknown. It stays, because lines of the log must not be erased.
        if not self._drawn or max(self._drawn) > size.columns:
            return ""
        return _TO_START + _UP.format(len(self._drawn))

    def _fitting(self, size: Size) -> list[Line]:
        # The cursor is below the last line, and cannot move to lines that have scrolled away.
        if self._is_closed or size.lines < 2 or size.columns < 2:
            return []
        lines = list(self._render(size))[: size.lines - 1]
        # Some terminals wrap a line that ends in the last column.
        return [self._cut(line, size.columns - 1) for line in lines]

    def _cut(self, line: Line, room: int) -> Line:
        # Measured after encoding: the escape of a character that the terminal lacks is longer.
        text = self._encoded(on_one_line(line.text)).decode(self._encoding)
        return line._replace(text=text if cell_len(text) <= room else set_cell_size(text, room))

    def _encoded(self, text: str) -> bytes:
        return text.encode(self._encoding, "backslashreplace")


def _coloured(line: Line) -> str:
    return f"{line.colour}{line.text}{_NORMAL}" if line.colour else line.text


ENABLE_VIRTUAL_TERMINAL_PROCESSING = 0x0004
_NO_CURSOR = frozenset({"dumb", "unknown"})


@contextlib.contextmanager
def cursor_moves(descriptor: int) -> Generator[bool]:
    """Yield whether a program may move the cursor of the terminal with this descriptor.

    On Windows, the console interprets such sequences while the context lasts; before Windows 10
    it cannot.
    """
    with contextlib.ExitStack() as stack:
        yield os.isatty(descriptor) and _prepared(descriptor, stack)


def shows_colours() -> bool:
    """Whether a terminal may be given colours (https://no-color.org).

    A Windows console shows them only while `cursor_moves` lasts.
    """
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") not in _NO_CURSOR


def terminal_size(descriptor: int) -> Size | None:
    """Return the size of a terminal; None while this process is in the background."""
    if sys.platform == "win32":
        return _window(descriptor)
    try:
        columns, lines = os.get_terminal_size(descriptor)
    except OSError:
        return None
    # A serial console reports a size of 0.
    return Size(columns or 80, lines or 24) if _is_in_front(descriptor) else None


def _is_in_front(descriptor: int) -> bool:
    if sys.platform == "win32":
        return True
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:
        # Not the controlling terminal of this process, so that no shell puts it in the background.
        return True


if sys.platform == "win32":
    import ctypes
    import msvcrt
    from ctypes import wintypes

    class _Coordinates(ctypes.Structure):
        """``COORD``."""

        _fields_ = (("x", wintypes.SHORT), ("y", wintypes.SHORT))

    class _BufferInfo(ctypes.Structure):
        """``CONSOLE_SCREEN_BUFFER_INFO``."""

        _fields_ = (
            ("size", _Coordinates),
            ("cursor", _Coordinates),
            ("attributes", wintypes.WORD),
            ("window", wintypes.SMALL_RECT),
            ("largest", _Coordinates),
        )

    _kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    _kernel.GetConsoleMode.argtypes = [wintypes.HANDLE, ctypes.POINTER(wintypes.DWORD)]
    _kernel.GetConsoleMode.restype = wintypes.BOOL
    _kernel.SetConsoleMode.argtypes = [wintypes.HANDLE, wintypes.DWORD]
    _kernel.SetConsoleMode.restype = wintypes.BOOL
    _kernel.GetConsoleScreenBufferInfo.argtypes = [wintypes.HANDLE, ctypes.POINTER(_BufferInfo)]
    _kernel.GetConsoleScreenBufferInfo.restype = wintypes.BOOL

    def _prepared(descriptor: int, stack: contextlib.ExitStack) -> bool:
        console = msvcrt.get_osfhandle(descriptor)
        before = wintypes.DWORD()
        if not _kernel.GetConsoleMode(console, ctypes.byref(before)):
            return False
        if not _kernel.SetConsoleMode(console, before.value | ENABLE_VIRTUAL_TERMINAL_PROCESSING):
            return False
        stack.callback(_kernel.SetConsoleMode, console, before.value)
        return True

    def _window(descriptor: int) -> Size | None:
        info = _BufferInfo()
        console = msvcrt.get_osfhandle(descriptor)
        if not _kernel.GetConsoleScreenBufferInfo(console, ctypes.byref(info)):
            return None
        seen = info.window
        return Size(seen.Right - seen.Left + 1, seen.Bottom - seen.Top + 1)
else:

    def _prepared(descriptor: int, stack: contextlib.ExitStack) -> bool:
        del descriptor, stack
        return os.environ.get("TERM", "dumb") not in _NO_CURSOR
