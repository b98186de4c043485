"""Writes the log to console and file on their own threads, so that logging never blocks."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from functools import partial
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from biosensor_common import nonblocking_writer
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.nonblocking_writer import (
    LAST_LINES_S,
    STDERR,
    STDOUT,
    NonblockingWriter,
    console,
    missing,
    relayed,
)
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.settings.places import STATE_VARIABLE
from biosensor_gateway.system import state_file
from biosensor_gateway.system.console_lines import (
    LinesForPeople,
    Panel,
    cursor_moves,
    on_one_line,
    shows_colours,
    terminal_size,
    without_line_for_people,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


# Generous for a busy disk: the file is opened before anything streams.
HELD_AFTER_S = OPENED_WITHIN_S = 2.0

_LOGGER = "biosensor_gateway.logs"
_log = structlog.get_logger(_LOGGER)


class QueuedHandler(logging.StreamHandler["_Lines"]):
    """Formats records in the logging thread, and writes them in the output's thread.

    If an output is blocked, all outputs report it once. Lines that do not fit into its queue are
    dropped, and a line in their place has their number.
    """

    def __init__(
        self, name: str, writer: NonblockingWriter, encoding: str, terminal: int | None = None
    ) -> None:
        super().__init__(_Lines(writer, encoding))
        self.set_name(name)
        self.writer = writer
        self.encoding = encoding
        # A separate descriptor of the terminal; None if the output is not a terminal.
        self.terminal = terminal
        self._is_held = False
        writer.notice = self._notice

    def columns(self) -> int | None:
        """Width of the terminal; None if the output is not a terminal."""
        size = None if self.terminal is None else terminal_size(self.terminal)
        return None if size is None else size.columns

    def handle(self, record: logging.LogRecord) -> bool:
        """Format and queue the record, and log it once if the output is blocked."""
        handled = super().handle(record)
        # Not in emit, which holds the handler's lock: two such handlers could deadlock.
        was_held, self._is_held = self._is_held, self.writer.held_for_s > HELD_AFTER_S
        if self._is_held and not was_held:
            _log.warning(
                f"the {self.writer.name} accepts no output; streaming continues, and lines that "
                "do not fit are left out there"
            )
        return handled

    def close(self) -> None:
        """Wait a moment until the last lines are written."""
        self.writer.close(nonblocking_writer.LAST_LINES_S)
        if self.terminal is not None:
            os.close(self.terminal)
            self.terminal = None
        super().close()

    def _notice(self, count: int) -> bytes:
        text = missing(count, self.writer.name)
        record = logging.LogRecord(_LOGGER, logging.WARNING, "", 0, text, None, None)
        return f"{self.format(record)}{self.terminator}".encode(self.encoding, "backslashreplace")


class _Lines:
    """The stream to which `logging` writes."""

    def __init__(self, writer: NonblockingWriter, encoding: str) -> None:
        self._writer, self._encoding = writer, encoding

    def write(self, text: str) -> None:
        self._writer.put(text.encode(self._encoding, "backslashreplace"))


def console_handler(name: str) -> QueuedHandler | None:
    """Return a handler that writes to stderr; None if there is no stderr."""
    # A windowed program on Windows has no stderr, although its type does not say so.
    stream = cast("TextIO | None", sys.stderr)
    if stream is None:
        return None
    try:
        descriptor = stream.fileno()
    except io.UnsupportedOperation:
        # An object without a descriptor, as in tests.
        writer = NonblockingWriter(
            "console", lambda lines: stream.write(lines.decode(stream.encoding))
        )
        return QueuedHandler(name, writer, stream.encoding)
    writer = nonblocking_writer.console(descriptor, "console")
    if writer is None:
        return None
    # A copy, because the descriptor itself is redirected while the console is relayed.
    terminal = os.dup(descriptor) if os.isatty(descriptor) else None
    return QueuedHandler(name, writer, stream.encoding, terminal)


def file_handler(name: str, path: Path, max_bytes: int, keep_files: int) -> QueuedHandler:
    """Return a handler that writes to a rotating file, whose folder is created if needed.

    Raises
    ------
    OSError
        If the file cannot be written. ``TimeoutError`` if the disk does not answer.
    """
    file = _LogFile(path, maxBytes=max_bytes, backupCount=keep_files, encoding="utf-8", delay=True)
    _open_in_time(file)
    return QueuedHandler(name, NonblockingWriter("log file", file.append, end=file.end), "utf-8")


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
    """A log file for one thread, which may block in a write while the process ends.

    A failure is logged once, and the next line tries again.
    """

    terminator = ""
    _is_failing = _has_failed = False

    def createLock(self) -> None:  # noqa: N802 - the base class's name
        # `logging` takes every handler's lock at exit, and would wait for a blocked thread.
        self.lock = None

    def flush(self) -> None:
        """Do nothing; nothing is buffered."""

    def close(self) -> None:
        """Do nothing; `logging` calls this at exit, in another thread. See `end`."""

    def open(self) -> None:
        """Open the file, and create its folder if needed; raises ``OSError``."""
        state_file.make_folder(Path(self.baseFilename).parent)
        self.stream = self._open()

    def append(self, lines: bytes) -> None:
        """Write whole lines."""
        self._has_failed = False
        self.emit(logging.LogRecord("", 0, "", 0, lines.decode(), None, None))
        self._is_failing = self._has_failed

    def end(self) -> None:
        """Close the file."""
        # Not the base class's `close`, which needs a lock from Python 3.13 on.
        if self.stream:
            self.stream.close()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the base class's name
        error = sys.exception()
        if not isinstance(error, OSError):
            super().handleError(record)
            return
        if not self._is_failing:
            # Set before logging, because the warning comes to this file as well.
            self._is_failing = True
            _log.warning(
                f"cannot write the log file {self.baseFilename}: {error.strerror or error}; "
                "streaming continues without it"
            )
        self._has_failed = True

    def _open(self) -> io.TextIOWrapper:
        return io.TextIOWrapper(
            _Unbuffered(self.baseFilename, "a"), encoding=self.encoding, write_through=True
        )


class _Unbuffered(io.FileIO):
    """A file without Python's buffer, for whose lock the interpreter would wait at exit."""

    def write(self, data: ReadableBuffer, /) -> int:
        left = memoryview(data)
        nonblocking_writer.write_all(super().write, left)
        return left.nbytes


LOG_FILE_NAME = "biosensor-gateway.log"

_OWN_LOGGER = "biosensor_gateway"
_CONSOLE, _FILE = "biosensor-gateway.console", "biosensor-gateway.file"
_MASK = "***"
_SENSITIVE = r"(?:secret|passw|token|client_?id|api_?key|credential|authorization)"
_SENSITIVE_KEY = re.compile(_SENSITIVE, re.IGNORECASE)
# key = value, key: value and "key": "value", also with the quotes escaped
_SENSITIVE_TEXT = re.compile(
    rf"""(?P<key>{_SENSITIVE}\w{{0,32}}\\*["']?\s*[=:]\s*)
         (?:\\*"[^"]*"|\\*'[^']*'|(?:bearer\s+)?[^\s,;&)}}\]]+)""",
    re.IGNORECASE | re.VERBOSE,
)
# Before the settings are read the limits are unknown, and a rotation could delete an old file.
_NEVER_FULL = 0

_COMMON: tuple[Processor, ...] = (
    structlog.contextvars.merge_contextvars,
    structlog.stdlib.add_logger_name,
    structlog.stdlib.add_log_level,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
)


def configure_logs(
    settings: LogSettings,
    folder: Path | None,
    *,
    verbose: bool = False,
    title: Callable[[str], str] = str,
) -> None:
    """Send all logging to the console and to a file, instead of earlier handlers.

    Libraries are never logged below ``info``, because their debug lines have samples
    and whole messages.

    Parameters
    ----------
    settings
        Level, and size and number of files.
    folder
        Folder of ``biosensor-gateway.log``, created if needed; ``None`` for
        the console only.
    verbose
        Log at level ``debug`` instead of the settings' level.
    title
        Returns a sensor's name for people, for a terminal.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the file cannot be written. The earlier handlers stay,
        so that the caller can go on with ``folder=None``.
    """
    file = _file_handler(folder, settings.max_bytes, settings.keep_files) if folder else None
    end_logs()
    root = logging.getLogger()
    for handler in (_console_handler(title, verbose=verbose), file):
        if handler is not None:
            root.addHandler(handler)
    level = logging.DEBUG if verbose else logging.getLevelNamesMapping()[settings.level.upper()]
    _configure(level)


def log_to_file_alone(folder: Path) -> None:
    """Send all logging to the file only, before the settings are read.

    Raises
    ------
    ConfigError
        As for `configure_logs`.
    """
    file = _file_handler(folder, _NEVER_FULL, 0)
    end_logs()
    logging.getLogger().addHandler(file)
    _configure(logging.INFO)


def _configure(level: int) -> None:
    logging.getLogger().setLevel(max(level, logging.INFO))
    logging.getLogger(_OWN_LOGGER).setLevel(level)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *_COMMON,
            structlog.stdlib.PositionalArgumentsFormatter(),
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
    )


def flush_logs(limit_s: float = LAST_LINES_S) -> bool:
    """Wait until everything is written, at most *limit_s* for each output; return whether it is."""
    flushed = [handler.writer.flush(limit_s) for handler in _own_handlers()]
    return all(flushed)


def end_logs() -> None:
    """Write the last lines, at most `LAST_LINES_S` for each output, and stop logging."""
    for handler in _own_handlers():
        logging.getLogger().removeHandler(handler)
        handler.close()


@contextlib.contextmanager
def console_relayed() -> Generator[Panel | None]:
    """Relay all output of this process to the console, so that a blocked console blocks nothing.

    To be used after `configure_logs`. At the end, the last lines are written for at most
    `LAST_LINES_S`, and logging stops.

    Yields
    ------
    Panel or None
        A panel below the log; None if the log does not go to a terminal with a movable cursor.
    """
    handler = next((each for each in _own_handlers() if each.get_name() == _CONSOLE), None)
    with contextlib.ExitStack() as stack:
        panel = stack.enter_context(_panel(handler))
        stderr = handler.writer if handler is not None else None
        # Other output to the same terminal has to appear above the panel as well.
        is_shared = panel is not None and os.isatty(STDOUT)
        stdout = stderr if is_shared else console(STDOUT, "console")
        stack.enter_context(relayed([(STDOUT, stdout), *([(STDERR, stderr)] if stderr else [])]))
        if panel is not None:
            stack.callback(panel.close)
        yield panel
    end_logs()


@contextlib.contextmanager
def _panel(handler: QueuedHandler | None) -> Generator[Panel | None]:
    if handler is None or handler.terminal is None:
        yield None
        return
    terminal = handler.terminal
    with cursor_moves(terminal) as can_move:
        size = partial(terminal_size, terminal)
        yield Panel(handler.writer, size, handler.encoding) if can_move else None


def _own_handlers() -> list[QueuedHandler]:
    return [each for each in logging.getLogger().handlers if isinstance(each, QueuedHandler)]


def _console_handler(title: Callable[[str], str], *, verbose: bool) -> QueuedHandler | None:
    handler = console_handler(_CONSOLE)
    if handler is None:
        return None
    processors = (_exception_in_short, _mask_secrets)
    if not sys.stderr.isatty():
        plain = structlog.dev.ConsoleRenderer(
            colors=False,
            sort_keys=False,
            repr_native_str=True,
            exception_formatter=structlog.dev.plain_traceback,
        )
        processors = (*processors, without_line_for_people, _event_on_one_line, plain)
    else:
        # A Windows console understands colours only while a panel is drawn.
        colours = shows_colours() and sys.platform != "win32"
        lines = LinesForPeople(title, handler.columns, colours=colours, verbose=verbose)
        processors = (*processors, lines)
    handler.setFormatter(_formatter(*processors))
    return handler


def _file_handler(folder: Path, max_bytes: int, keep_files: int) -> QueuedHandler:
    path = folder / LOG_FILE_NAME
    try:
        handler = file_handler(_FILE, path, max_bytes, keep_files)
    except OSError as error:
        message = (
            f"cannot write the log file in {folder}: {error.strerror or error}; set "
            f"{STATE_VARIABLE} to a folder that can be written"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    renderer = structlog.processors.JSONRenderer()
    processors = (structlog.processors.format_exc_info, without_line_for_people, _mask_secrets)
    handler.setFormatter(_formatter(*processors, renderer))
    return handler


def _formatter(*processors: Processor) -> logging.Formatter:
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=_COMMON,
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *processors],
    )


def _exception_in_short(_logger: WrappedLogger, _method: str, event_dict: EventDict) -> EventDict:
    """Replace the exception by its class and text; the file has the traceback."""
    raised: object = event_dict.pop("exc_info", None)
    event_dict.pop("stack_info", None)
    if raised is True:
        raised = sys.exc_info()
    if isinstance(raised, tuple):
        raised = cast("tuple[object, ...]", raised)[1]
    if isinstance(raised, BaseException):
        event_dict["cause"] = f"{type(raised).__name__}: {raised}"
    return event_dict


def _mask_secrets(_logger: WrappedLogger, _method: str, event_dict: EventDict) -> EventDict:
    return {key: _masked(key, value) for key, value in event_dict.items()}


def _masked(key: object, value: object) -> object:
    if isinstance(key, str) and _SENSITIVE_KEY.search(key):
        return _MASK
    if isinstance(value, str):
        return _SENSITIVE_TEXT.sub(rf"\g<key>{_MASK}", value)
    if isinstance(value, Mapping):
        entries = cast("Mapping[object, object]", value)
        return {inner: _masked(inner, entry) for inner, entry in entries.items()}
    if isinstance(value, list | tuple):
        return [_masked(None, entry) for entry in cast("list[object]", value)]
    return value


def _event_on_one_line(_logger: WrappedLogger, _method: str, event_dict: EventDict) -> EventDict:
    """Escape line ends and terminal commands, as the renderer does for the values."""
    event_dict["event"] = on_one_line(str(event_dict.get("event", "")))
    return event_dict
