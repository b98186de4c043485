"""Cuts text into lines, and has each of them read."""

from __future__ import annotations

from collections.abc import Callable

from biosensor_gateway.devices.line_sensor.driver.protocol.rows import (
    MAX_LINE_BYTES,
    BadLine,
    Flaw,
    Row,
    Wrong,
)

COMMENT = b"#"
_SHOWN = 60

ReadLine = Callable[[str], Row | Wrong | None]
"""Gives the values of a line, or what is wrong with it; None for one that means nothing."""


class LineProtocol:
    """Lines that end in LF or CR LF; those that begin with ``#`` are comments.

    Parameters
    ----------
    read_line
        Reads a line without its end and without blanks around it.
    skips_first
        Whether the first line may have lost its beginning, as where a port is opened while the
        device sends.
    """

    def __init__(self, read_line: ReadLine, *, skips_first: bool = False) -> None:
        self._read_line = read_line
        self._is_skipping = skips_first
        self._buffer = bytearray()
        self._too_long = 0

    @property
    def buffered(self) -> int:
        """Bytes that wait for the end of their line."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Take bytes; return what the lines that are complete say."""
        found: list[Row | BadLine] = []
        *ended, rest = (bytes(self._buffer) + data).split(b"\n")
        for each in ended:
            said = self._line(each)
            if said is not None:
                found.append(said)
        # Of a line without an end only its length is kept.
        if len(rest) > MAX_LINE_BYTES:
            self._too_long += len(rest)
            rest = b""
        self._buffer = bytearray(rest)
        return found

    def feed_whole(self, data: bytes) -> list[Row | BadLine]:
        """Take a message, whose last line needs no end."""
        return self.feed(data if data.endswith(b"\n") else data + b"\n")

    def _line(self, raw: bytes) -> Row | BadLine | None:
        size, self._too_long = self._too_long + len(raw) + 1, 0
        if self._is_skipping:
            self._is_skipping = False
            return None
        if size > MAX_LINE_BYTES:
            return BadLine(Flaw.TOO_LONG, raw[:_SHOWN], size, f"is longer than {MAX_LINE_BYTES}")
        line = raw.strip()
        if not line or line.startswith(COMMENT):
            return None
        if not line.isascii() or b"\0" in line:
            return BadLine(Flaw.NOT_TEXT, line[:_SHOWN], size, "is no text")
        said = self._read_line(line.decode("ascii"))
        if isinstance(said, Wrong):
            return BadLine(said.flaw, line[:_SHOWN], size, said.why)
        return said
