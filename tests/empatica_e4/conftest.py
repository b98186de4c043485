"""A plain socket client of the E4 streaming server."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import pytest

from biosensor_gateway.simulation.world import World

DEADLINE_S = 20.0


class Line(NamedTuple):
    """A line of data."""

    word: str
    stamp: float
    values: tuple[float, ...]


class LineClient:
    """Reads bytes as they come, with no knowledge of the product's parser."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.socket = socket.create_connection(
            (settings["host"], settings["port"]), timeout=DEADLINE_S
        )
        self._file = self.socket.makefile("rb")
        self.data: list[bytes] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        self.socket.close()

    def send(self, request: str, end: str = "\r\n") -> None:
        self.socket.sendall((request + end).encode())

    def read(self) -> bytes:
        """Return the next line with its end; empty at the end of the connection."""
        line = self._file.readline()
        if line.startswith(b"E4_"):
            self.data.append(line)
        return line

    def reply(self) -> str:
        """Return the next line that is no data."""
        while (line := self.read()).startswith(b"E4_"):
            pass
        return line.decode()

    def ask(self, request: str, end: str = "\r\n") -> str:
        self.send(request, end)
        return self.reply()

    def begin(
        self, device_id: str = "9ff167", streams: str = "acc bvp gsr ibi tmp bat tag"
    ) -> None:
        """Bind and subscribe."""
        assert self.ask(f"device_connect {device_id}") == "R device_connect OK\n"
        for stream in streams.split():
            assert self.ask(f"device_subscribe {stream} ON") == f"R device_subscribe {stream} OK\n"

    def until(self, condition: Callable[[], object]) -> None:
        """Read until a condition holds."""
        while not condition():
            assert self.read(), "the connection ended"

    def until_lines(self, word: str, count: int) -> None:
        self.until(lambda: len(self.raw(word)) >= count)

    def until_closed(self) -> None:
        while self.read():
            pass

    def raw(self, word: str) -> list[bytes]:
        return [line for line in self.data if line.startswith(f"{word} ".encode())]

    def lines(self, word: str) -> list[Line]:
        return [parse(line) for line in self.raw(word)]


def parse(line: bytes) -> Line:
    word, *numbers = line.decode().replace(",", ".").replace("\u2212", "-").split()
    stamp, *values = map(float, numbers)
    return Line(word, stamp, tuple(values))


@pytest.fixture
def world() -> Iterator[World]:
    with World() as world:
        yield world


@pytest.fixture
def line_client() -> type[LineClient]:
    return LineClient


@pytest.fixture(scope="session")
def vectors() -> dict[str, Any]:
    """Return the protocol's vectors and scenarios."""
    path = Path(__file__).parent / "vectors" / "empatica_e4.json"
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded
