"""Terminals: one that a person looks at, and one that takes no output."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import signal
import subprocess
import termios
import threading
import time
import tty
from collections.abc import Callable, Generator, Mapping, Sequence

# A terminal that a person looks at: what stands on its screen, and in what has scrolled away.

# Up, clear, colours, and whether the cursor is seen.
_COMMAND = re.compile(r"\x1b\[\??(\d*)(?:;\d+)*([AJKmhl])")
_BLOCK = 1 << 16
_DEADLINE_S = 60.0
_POLL_S = 0.02


class Screen:
    """Interprets what is written to a terminal; it breaks lines, and does not fix them."""

    def __init__(self, columns: int = 80, lines: int = 24) -> None:
        self.columns, self.height = columns, lines
        self.pictures = 0  # How often something was drawn over.
        self._gone: list[str] = []
        self._rows = [""]
        self._x = self._y = 0
        self._rest = ""

    @property
    def lines(self) -> list[str]:
        """Everything, from the first line that has scrolled away."""
        return [line.rstrip() for line in [*self._gone, *self._rows]]

    @property
    def text(self) -> str:
        """The same as one text."""
        return "\n".join(self.lines)

    def feed(self, text: str) -> None:
        """Show text."""
        text, self._rest = self._rest + text, ""
        at = 0
        while at < len(text):
            if text[at] != "\x1b":
                self._letter(text[at])
                at += 1
            elif found := _COMMAND.match(text, at):
                self._obey(found[1], found[2])
                at = found.end()
            elif len(text) - at < 8:
                self._rest = text[at:]
                return
            else:
                raise AssertionError(f"not known: {text[at : at + 8]!r}")

    def resize(self, columns: int, lines: int) -> None:
        """Make it wider or narrower; what stands there stays as it is."""
        self.columns, self.height = columns, lines
        while len(self._rows) > lines:
            self._gone.append(self._rows.pop(0))
            self._y = max(0, self._y - 1)

    def _obey(self, number: str, command: str) -> None:
        if command == "A":
            self.pictures += 1
            self._y = max(0, self._y - int(number or 1))
        elif command in "JK":
            assert number in ("", "0") or (number, command) == ("2", "K")
            kept = 0 if number == "2" else self._x
            self._rows[self._y] = self._rows[self._y][:kept]
            if command == "J":
                del self._rows[self._y + 1 :]

    def _letter(self, letter: str) -> None:
        if letter == "\r":
            self._x = 0
        elif letter == "\n":
            self._next_line()
        elif letter == "\a":
            pass
        else:
            assert letter.isprintable(), repr(letter)
            if self._x >= self.columns:
                self._x = 0
                self._next_line()
            row = self._rows[self._y].ljust(self._x)
            self._rows[self._y] = row[: self._x] + letter + row[self._x + 1 :]
            self._x += 1

    def _next_line(self) -> None:
        self._y += 1
        if self._y == len(self._rows):
            self._rows.append("")
        if self._y == self.height:
            self._gone.append(self._rows.pop(0))
            self._y -= 1


class Terminal:
    """A program on a pseudo-terminal of its own, and whoever sits at it."""

    def __init__(self, process: int, ours: int, screen: Screen) -> None:
        self._process, self._ours = process, ours
        self.screen = screen
        self.raw = ""
        self._code: int | None = None
        self._failure: AssertionError | None = None
        self._changed = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def type(self, text: str | bytes) -> None:
        """Type on its keyboard."""
        os.write(self._ours, text if isinstance(text, bytes) else text.encode())

    def resize(self, columns: int, lines: int) -> None:
        """Make the window larger or smaller."""
        with self._changed:
            termios.tcsetwinsize(self._ours, (lines, columns))
            self.screen.resize(columns, lines)

    def until(self, holds: Callable[[str], object]) -> str:
        """Wait until what can be seen is as it should be; return it."""
        deadline = time.monotonic() + _DEADLINE_S
        while True:
            with self._changed:
                text = self.screen.text
            if self._failure is not None:
                raise self._failure
            if holds(text):
                return text
            assert time.monotonic() < deadline, f"never seen; there stands:\n{text}"
            time.sleep(_POLL_S)

    def until_seen(self, text: str, times: int = 1) -> str:
        """Wait until a text stands there so many times."""
        return self.until(lambda seen: seen.count(text) >= times)

    def exit_code(self) -> int:
        """Wait until the program has ended and all it wrote is shown."""
        deadline = time.monotonic() + _DEADLINE_S
        while self._code is None:
            ended, status = os.waitpid(self._process, os.WNOHANG)
            if ended:
                self._code = os.waitstatus_to_exitcode(status)
            assert time.monotonic() < deadline, (
                f"it does not end; there stands:\n{self.screen.text}"
            )
            time.sleep(_POLL_S)
        self._reader.join(_DEADLINE_S)
        if self._failure is not None:
            raise self._failure
        return self._code

    def close(self) -> None:
        """End the program whatever it does."""
        if self._code is None:
            os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
        self._reader.join(_DEADLINE_S)
        os.close(self._ours)

    def _read(self) -> None:
        # The end of a pseudo-terminal is an error on Linux.
        with contextlib.suppress(OSError):
            while block := os.read(self._ours, _BLOCK):
                text = block.decode(errors="replace")
                with self._changed:
                    self.raw += text
                    try:
                        self.screen.feed(text)
                    except AssertionError as error:
                        self._failure = error
                        return


@contextlib.contextmanager
def at_terminal(
    command: Sequence[str],
    environment: Mapping[str, str],
    columns: int = 80,
    lines: int = 24,
) -> Generator[Terminal]:
    """Start a program at a terminal, which its shell has put in front."""
    process, ours = pty.fork()
    if process == 0:
        try:
            termios.tcsetwinsize(1, (lines, columns))
            # Left in the environment, these would go before the terminal's own size.
            kept = {k: v for k, v in environment.items() if k not in ("COLUMNS", "LINES")}
            os.execvpe(command[0], list(command), kept)
        finally:
            os._exit(127)
    terminal = Terminal(process, ours, Screen(columns, lines))
    try:
        yield terminal
    finally:
        terminal.close()


# A terminal that takes no output: nobody reads its other end, or it was stopped by Ctrl-S.
class HeldConsole:
    """The terminal of one program; whoever writes to it waits until it is released.

    Parameters
    ----------
    is_stopped
        It was stopped by its user; otherwise it is full as soon as the kernel's buffer is.
    """

    def __init__(self, *, is_stopped: bool) -> None:
        self._ours, self._terminal = os.openpty()
        tty.setraw(self._terminal)
        self._is_stopped = is_stopped
        if is_stopped:
            termios.tcflow(self._terminal, termios.TCOOFF)
        self._shown = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)

    @contextlib.contextmanager
    def program(
        self, command: Sequence[str], environment: Mapping[str, str]
    ) -> Generator[subprocess.Popen[bytes]]:
        """Run a program there; whatever becomes of it, it is gone in the end."""
        process = subprocess.Popen(
            command,
            stdin=self._terminal,
            stdout=self._terminal,
            stderr=self._terminal,
            env=environment,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()
            os.close(self._terminal)
            os.close(self._ours)

    @property
    def takes_output(self) -> bool:
        """Whether a program could write now without waiting."""
        return bool(select.select([], [self._terminal], [], 0)[1])

    def release(self) -> None:
        """Show everything from now on."""
        if self._is_stopped:
            termios.tcflow(self._terminal, termios.TCOON)
        self._reader.start()

    @property
    def shown(self) -> str:
        """What came since it was released."""
        return bytes(self._shown).decode()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while block := os.read(self._ours, _BLOCK):
                self._shown += block
