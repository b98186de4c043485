"""Connects the first process of the node with a further one."""

from __future__ import annotations

import os
import pickle
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from typing import Any

from lsl_to_ros.processes.mail import Settings

_BROKEN = (EOFError, OSError, pickle.UnpicklingError)


def first_message(end: socket.socket) -> Any:  # noqa: ANN401 - what the other side sends
    """Wait for the first thing that comes, before there is a link.

    Raises
    ------
    EOFError
        If the other side is gone.
    """
    with _connection(end) as connection:
        return connection.recv()


class Link:
    """Sends and receives objects without ever waiting, in two threads of its own.

    Of a state that the other side has not taken yet, only the newest is kept.

    Parameters
    ----------
    end
        Of a pair of sockets.
    wake
        Called by a thread when something has come or the other side is gone.
    """

    def __init__(self, end: socket.socket, wake: Callable[[], None]) -> None:
        self._socket = end
        self._connection = _connection(end)
        self._wake = wake
        self._received: deque[Any] = deque()
        self._unsent: dict[object, Any] = {}
        self._numbers = count()
        self._is_something_to_do = threading.Condition()
        self._is_closed = False

    def start(self) -> None:
        """Begin to send and to receive."""
        for work in (self._read, self._write):
            threading.Thread(target=work, daemon=True, name=f"link: {work.__name__}").start()

    @property
    def is_closed(self) -> bool:
        """Whether the other side is gone."""
        return self._is_closed

    def send(self, message: object) -> None:
        """Send a message as soon as the other side takes it."""
        is_state = not isinstance(message, Settings)
        key: object = type(message) if is_state else next(self._numbers)
        with self._is_something_to_do:
            self._unsent[key] = message
            self._is_something_to_do.notify()

    def received(self) -> Iterator[Any]:
        """Yield what has come, each once."""
        with suppress(IndexError):
            while True:
                yield self._received.popleft()

    def close(self) -> None:
        """Let the other side know that nothing more comes."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _read(self) -> None:
        with suppress(*_BROKEN):
            while True:
                self._received.append(self._connection.recv())
                self._wake()
        self._end()

    def _write(self) -> None:
        with suppress(*_BROKEN):
            while (message := self._next()) is not None:
                self._connection.send(message)

    def _next(self) -> object | None:
        """Wait for something to send; None at the end."""
        with self._is_something_to_do:
            while not self._unsent and not self._is_closed:
                self._is_something_to_do.wait()
            return None if self._is_closed else self._unsent.pop(next(iter(self._unsent)))

    def _end(self) -> None:
        with self._is_something_to_do:
            self._is_closed = True
            self._is_something_to_do.notify()
        self._wake()


def _connection(end: socket.socket) -> Connection[Any, Any]:
    return Connection(os.dup(end.fileno()))
