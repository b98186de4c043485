"""The side that answers: listens for a while, for one who knows the code."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from biosensor_common.doctor.check import Context
from biosensor_common.doctor.probe import ProbeError
from biosensor_common.doctor.two_sided import handshake
from biosensor_common.doctor.two_sided.channel import Channel, Message
from biosensor_common.doctor.two_sided.code import new_code
from biosensor_common.doctor.two_sided.commands import (
    Command,
    run_of,
    source_id_of,
    streams_of,
    targets_of,
    with_streams,
    with_targets,
)
from biosensor_common.doctor.two_sided.facts import End, as_message, read_end
from biosensor_common.doctor.two_sided.station import Station
from biosensor_common.errors import (
    CredentialError,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

PATIENCE_S = 600.0
"""After so long nobody listens any more."""
MAX_TRIES = 5
COMMAND_S = 60.0
_BACKLOG, _STEP_S = 4, 0.5

Say = Callable[[str], None]


class Answerer:
    """Listens at a TCP port; a context manager.

    Parameters
    ----------
    context
        How the program takes part in LSL.
    program
        ``agent`` or ``node``.
    port
        0 for any that is free.
    address
        Of this computer; all of them unless one is named.

    Attributes
    ----------
    code
        What the other side must know.
    port
        At which it listens.
    is_busy
        Whether somebody who came is being answered.

    Raises
    ------
    TransportError
        On entering: ``BUSY`` if the port cannot be had.
    """

    def __init__(
        self,
        context: Context,
        program: str,
        port: int,
        *,
        address: str = "",
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._context, self._program = context, program
        self._place = (address, port)
        self._patience_s = patience_s
        self._stack = ExitStack()
        self._is_given_up = threading.Event()
        self.is_busy = False
        self.code = new_code()
        self.port = port

    def __enter__(self) -> Self:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if sys.platform != "win32":
            # Else a second test would have to wait for a minute after the first; Windows needs
            # no such word, and would let two programs have the port by it.
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(self._place)
            self._listener.listen(_BACKLOG)
        except OSError as error:
            self._listener.close()
            raise TransportError(
                TransportReason.BUSY,
                f"TCP {self._place[1]} cannot be had here ({error.strerror or error}); name "
                "another one on both computers: --port 16800",
            ) from error
        self._stack.callback(self._listener.close)
        self.port = self._listener.getsockname()[1]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def wait(self, say: Say) -> tuple[End, End]:
        """Answer until one conversation has come to its end.

        Parameters
        ----------
        say
            Takes a sentence about each who came and did not get to the end.

        Returns
        -------
        here, there
            What each of the two computers has found out.

        Raises
        ------
        TransportError
            ``SILENT``: nobody came in time, or until it was given up.
        CredentialError
            ``REJECTED``: the code was wrong too often.
        """
        end = time.monotonic() + self._patience_s
        tries = MAX_TRIES
        while True:
            connection, address = self._next(end)
            with connection:
                self.is_busy = True
                try:
                    return self._converse(Channel(connection, address))
                except CredentialError as problem:
                    tries -= 1
                    say(str(problem))
                    if not tries:
                        raise
                except GatewayError as problem:
                    say(str(problem))
                finally:
                    self.is_busy = False

    def give_up(self) -> None:
        """Have `wait` come to its end, from another thread; who is being answered is first."""
        self._is_given_up.set()

    def _next(self, end: float) -> tuple[socket.socket, str]:
        # In small steps, for Windows heeds Ctrl-C between them only.
        self._listener.settimeout(_STEP_S)
        while time.monotonic() < end and not self._is_given_up.is_set():
            try:
                connection, (address, _) = self._listener.accept()
            except TimeoutError:
                continue
            return connection, address
        if self._is_given_up.is_set():
            message = "nobody has asked; this computer does not answer any more"
            raise TransportError(TransportReason.SILENT, message)
        raise TransportError(
            TransportReason.SILENT,
            f"nobody asked within {self._patience_s / 60:g} minutes, so this computer does not "
            "answer any more",
        )

    def _converse(self, channel: Channel) -> tuple[End, End]:
        handshake.answer(channel, self.code)
        opening = _expected(channel, Command.OPEN)
        own = channel.connection.getsockname()[0]
        other = channel.connection.getpeername()[0]
        station = Station(
            self._context, self._program, own, other, run_of(opening), is_asking=False
        )
        try:
            here = station.__enter__()
        except ProbeError as problem:
            channel.send({"failed": str(problem)})
            raise ProtocolError(ProtocolReason.REFUSED, str(problem)) from problem
        with ExitStack() as stack:
            stack.push(station.__exit__)
            channel.send(with_targets(here.targets) | {"source_id": here.source_id})
            return _obey(channel, here, opening)


def _obey(channel: Channel, here: Station, opening: Message) -> tuple[End, End]:
    targets, source_id = targets_of(opening), source_id_of(opening)
    _expected(channel, Command.SEND)
    here.send(targets)
    channel.send({})
    _expected(channel, Command.LOOK)
    here.look(source_id)
    channel.send(with_streams(here.own_streams))
    here.knock(streams_of(_expected(channel, Command.KNOCK)))
    channel.send({})
    there = read_end(_expected(channel, Command.COMPARE).get("end"))
    end = here.end()
    channel.send({"end": as_message(end)})
    return end, there


def _expected(channel: Channel, command: Command) -> Message:
    message = channel.receive(COMMAND_S)
    if message.get("do") != command.value:
        raise ProtocolError(
            ProtocolReason.GARBAGE,
            f"{channel.name} said {str(message.get('do'))!r:.40} in place of {command.value!r}",
        )
    return message
