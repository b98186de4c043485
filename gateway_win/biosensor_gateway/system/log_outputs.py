"""Writes the log to console and file without letting anybody wait for either."""

from __future__ import annotations

import io
import logging
import os
import sys
import threading
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

import structlog

from biosensor_common import relay
from biosensor_common.outflow import Outflow, missing
from biosensor_gateway.system import state_file
from biosensor_gateway.system.terminal import terminal_size

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# A busy disk takes its time, and a file is opened before anything streams.
HELD_AFTER_S = OPENED_WITHIN_S = 2.0

_LOGGER = "biosensor_gateway.logs"
_log = structlog.get_logger(_LOGGER)


class QueuedHandler(logging.StreamHandler["_Lines"]):
    """Formats in the thread that logs, and leaves the writing to the output's own.

    An output that is held is said once, in all outputs; lines that did not fit are counted
    in a line of the log in their place.

    Attributes
    ----------
    terminal
        A descriptor of the terminal that the output is, its own; None if it is none.
    """

    def __init__(
        self, name: str, outflow: Outflow, encoding: str, terminal: int | None = None
    ) -> None:
        super().__init__(_Lines(outflow, encoding))
        self.set_name(name)
        self.outflow = outflow
        self.encoding = encoding
        self.terminal = terminal
        self._is_held = False
        outflow.notice = self._notice

    def columns(self) -> int | None:
        """How wide the terminal is; None if it is none."""
        size = None if self.terminal is None else terminal_size(self.terminal)
        return None if size is None else size.columns

    def handle(self, record: logging.LogRecord) -> bool:
        """Format and queue the record, and say so if the output has come to be held."""
        handled = super().handle(record)
        # Not in emit: two handlers that log with their locks held would wait for each other.
        was_held, self._is_held = self._is_held, self.outflow.held_for_s > HELD_AFTER_S
        if self._is_held and not was_held:
            _log.warning(
                f"the {self.outflow.name} takes no output; streaming goes on, and lines that "
                "do not fit are left out there"
            )
        return handled

    def close(self) -> None:
        """Give the last lines a moment, at the first call."""
        self.outflow.close(relay.LAST_LINES_S)
        if self.terminal is not None:
            os.close(self.terminal)
            self.terminal = None
        super().close()

    def _notice(self, count: int) -> bytes:
        text = missing(count, self.outflow.name)
        record = logging.LogRecord(_LOGGER, logging.WARNING, "", 0, text, None, None)
        return f"{self.format(record)}{self.terminator}".encode(self.encoding, "backslashreplace")


class _Lines:
    """The stream that `logging` writes to."""

    def __init__(self, outflow: Outflow, encoding: str) -> None:
        self._outflow, self._encoding = outflow, encoding

    def write(self, text: str) -> None:
        self._outflow.put(text.encode(self._encoding, "backslashreplace"))


def console_handler(name: str) -> QueuedHandler | None:
    """Return a handler that writes to stderr; None if there is none."""
    # A program without a console window on Windows has no stderr, whatever the type says.
    stream = cast("TextIO | None", sys.stderr)
    if stream is None:
        return None
    try:
        descriptor = stream.fileno()
    except io.UnsupportedOperation:
        # It is an object of Python alone, as in tests.
        outflow = Outflow("console", lambda lines: stream.write(lines.decode(stream.encoding)))
        return QueuedHandler(name, outflow, stream.encoding)
    outflow = relay.console(descriptor, "console")
    if outflow is None:
        return None
    # What the descriptor leads to changes while the console is relayed.
    terminal = os.dup(descriptor) if os.isatty(descriptor) else None
    return QueuedHandler(name, outflow, stream.encoding, terminal)


def file_handler(name: str, path: Path, max_bytes: int, keep_files: int) -> QueuedHandler:
    """Return a handler that writes to a rotating file, whose folder is made if needed.

    Raises
    ------
    OSError
        If the file cannot be written. ``TimeoutError`` if the disk does not answer.
    """
    file = _LogFile(path, maxBytes=max_bytes, backupCount=keep_files, encoding="utf-8", delay=True)
    _open_in_time(file)
    return QueuedHandler(name, Outflow("log file", file.append, end=file.end), "utf-8")


def _open_in_time(file: _LogFile) -> None:
    failures: list[OSError] = []
    given_up = threading.Event()

    def open_() -> None:
        try:
            file.open()
        except OSError as error:
            failures.append(error)
        if given_up.is_set():
            file.end()

    thread = threading.Thread(target=open_, name="opens the log file", daemon=True)
    thread.start()
    thread.join(OPENED_WITHIN_S)
    if thread.is_alive():
        given_up.set()
        raise TimeoutError(f"it does not open within {OPENED_WITHIN_S:g} s")
    for failure in failures:
        raise failure


class _LogFile(RotatingFileHandler):
    """A file for one thread, which may wait in a write for ever while the process ends.

    It says once when it cannot be written, and is tried again with each line.
    """

    terminator = ""
    _is_failing = _has_failed = False

    def createLock(self) -> None:  # noqa: N802 - the base class's name
        # `logging` takes the lock of every handler at exit, and would wait for the thread.
        self.lock = None

    def flush(self) -> None:
        """Do nothing; nothing is buffered."""

    def close(self) -> None:
        """Do nothing; `logging` calls this at exit, in another thread. See `end`."""

    def open(self) -> None:
        """Open the file, and make its folder if needed; raises ``OSError``."""
        state_file.make_folder(Path(self.baseFilename).parent)
        self.stream = self._open()

    def append(self, lines: bytes) -> None:
        """Write whole lines."""
        self._has_failed = False
        self.emit(logging.LogRecord("", 0, "", 0, lines.decode(), None, None))
        self._is_failing = self._has_failed

    def end(self) -> None:
        """Close the file."""
        # From Python 3.13 on, the base class's own needs a lock, of which there is none.
        if self.stream:
            self.stream.close()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the base class's name
        error = sys.exception()
        if not isinstance(error, OSError):
            super().handleError(record)
            return
        if not self._is_failing:
            # Before it is logged, because this file is asked to take it, too.
            self._is_failing = True
            _log.warning(
                f"cannot write the log file {self.baseFilename}: {error.strerror or error}; "
                "streaming goes on without it"
            )
        self._has_failed = True

    def _open(self) -> io.TextIOWrapper:
        return io.TextIOWrapper(
            _Unbuffered(self.baseFilename, "a"), encoding=self.encoding, write_through=True
        )


class _Unbuffered(io.FileIO):
    """Python's buffers have a lock, for which the end of the interpreter would wait."""

    def write(self, data: ReadableBuffer, /) -> int:
        left = memoryview(data)
        relay.write_all(super().write, left)
        return left.nbytes
