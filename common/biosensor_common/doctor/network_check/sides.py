"""The two sides of a conversation: the answering side listens, the asking side leads.

It starts each step on both sides: ``open`` test ports and a test stream, ``send`` to the other's
ports, ``look`` for the other's test stream and for all real streams, ``knock`` at the data ports of
the other's streams, ``compare`` the results.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from typing import Self

from biosensor_common.doctor.check import Context
from biosensor_common.doctor.network_check.channel import (
    Channel,
    Message,
    greet_as_answering,
    greet_as_asking,
    new_code,
    nonce,
    read_code,
)
from biosensor_common.doctor.network_check.facts import (
    End,
    Opened,
    Stream,
    as_message,
    read,
    read_run,
)
from biosensor_common.doctor.network_check.station import Station
from biosensor_common.doctor.probe import ProbeError
from biosensor_common.errors import (
    CredentialError,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.lsl.api_file import DEFAULT_PORT_RANGE, LSL_BASE_PORT

ANSWER_PORT = LSL_BASE_PORT + DEFAULT_PORT_RANGE - 1
"""Default port of the answering side: the last of LSL's ports, so that no other rule is needed."""
PATIENCE_S = 600.0
"""Time limit of waiting for the asking side."""
MAX_TRIES = 5
CONNECT_S = 5.0
COMMAND_S = 60.0
"""Time limit of a step, which allows for the slower of the two computers."""
_BACKLOG, _STEP_S = 4, 0.5

Say = Callable[[str], None]


class UnreachedError(TransportError):
    """The connection to the other computer failed.

    ``ABSENT`` if it refuses, ``SILENT`` without an answer, ``UNAVAILABLE`` if it is unknown.
    """


def ask(context: Context, program: str, host: str, port: int, code: str) -> tuple[End, End]:
    """Test the network to an answering computer; return the results of both.

    Raises
    ------
    UnreachedError
        There is no connection.
    TransportError
        ``SILENT`` or ``LOST``, later.
    CredentialError
        ``REJECTED``: the code is wrong.
    ProtocolError
        ``UNSUPPORTED``, ``GARBAGE``, ``REFUSED``.
    ProbeError
        LSL cannot be used on this computer.
    """
    typed = read_code(code)
    with _connected(host, port) as connection:
        channel = Channel(connection, host)
        greet_as_asking(channel, typed)
        own, other = connection.getsockname()[0], connection.getpeername()[0]
        run = nonce()
        here = Station(context, program, own, other, run, is_asking=True)
        with here.open():
            return _led_through(channel, here, run)


def _led_through(channel: Channel, here: Station, run: str) -> tuple[End, End]:
    def both(do: str, details: Message, part: Callable[[], None] = lambda: None) -> Message:
        """Start a step on the other side, and run it here at the same time."""
        channel.send({"do": do, **details})
        part()
        reply = channel.receive(COMMAND_S)
        if "failed" in reply:
            what = f"{channel.name} cannot do its part: {str(reply['failed'])[:300]}"
            raise ProtocolError(ProtocolReason.REFUSED, what)
        return reply

    there = read(Opened, both("open", asdict(here.opened) | {"run": run}))
    both("send", {}, lambda: here.send(there.targets))
    theirs = _streams_of(both("look", {}, lambda: here.look(there.source_id)))
    both("knock", _with_streams(here), lambda: here.knock(theirs))
    # The other side has sent everything before its last reply, so it has arrived by now.
    end = here.end()
    return end, read(End, both("compare", {"end": as_message(end)}).get("end"))


def _connected(host: str, port: int) -> socket.socket:
    try:
        address = socket.gethostbyname(host)
        return socket.create_connection((address, port), CONNECT_S)
    except (socket.gaierror, UnicodeError) as error:
        raise UnreachedError(TransportReason.UNAVAILABLE, f"{host} has no IPv4 address") from error
    except ConnectionRefusedError as error:
        what = f"{host} is reachable, but refuses TCP {port}"
        raise UnreachedError(TransportReason.ABSENT, what) from error
    except TimeoutError as error:
        what = f"nothing comes back from TCP {port} of {host}"
        raise UnreachedError(TransportReason.SILENT, what) from error
    except OSError as error:
        # For instance no route, or no answer to ARP.
        what = f"TCP {port} of {host} cannot be reached ({error.strerror or error})"
        raise UnreachedError(TransportReason.SILENT, what) from error


class Answerer:
    """The answering side, which listens at a TCP port; a context manager.

    Parameters
    ----------
    port
        0 for any free port.
    address
        Address of this computer to listen at; all of them by default.

    Raises
    ------
    TransportError
        On entering: ``BUSY`` if the port cannot be opened.
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
        self._address = address
        self._patience_s = patience_s
        self._is_given_up = threading.Event()
        self.is_busy = False
        self.code = new_code()
        self.port = port

    def __enter__(self) -> Self:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if sys.platform != "win32":
            # Otherwise a second test would have to wait a minute after the first. Windows does not
            # need the option, and would let two programs share the port with it.
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((self._address, self.port))
            self._listener.listen(_BACKLOG)
        except OSError as error:
            self._listener.close()
            raise TransportError(
                TransportReason.BUSY,
                f"TCP {self.port} is not available here ({error.strerror or error}); use another "
                "one on both computers: --port 16800",
            ) from error
        self.port = self._listener.getsockname()[1]
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def wait(self, say: Say) -> tuple[End, End]:
        """Answer until one conversation is complete; return the results, this computer's first.

        *say* is called with a sentence for each conversation that failed.

        Raises
        ------
        TransportError
            ``SILENT``: no connection in time, or before `give_up`.
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
                except GatewayError as problem:
                    say(str(problem))
                    tries -= isinstance(problem, CredentialError)
                    if not tries:
                        raise
                finally:
                    self.is_busy = False

    def give_up(self) -> None:
        """End `wait` from another thread, after the present conversation."""
        self._is_given_up.set()

    def _next(self, end: float) -> tuple[socket.socket, str]:
        # In small steps, because Windows handles Ctrl-C only between them.
        self._listener.settimeout(_STEP_S)
        while time.monotonic() < end and not self._is_given_up.is_set():
            try:
                connection, (address, _) = self._listener.accept()
            except TimeoutError:
                continue
            return connection, address
        if self._is_given_up.is_set():
            what = "no computer has asked; this computer no longer answers"
            raise TransportError(TransportReason.SILENT, what)
        raise TransportError(
            TransportReason.SILENT,
            f"no computer asked within {self._patience_s / 60:g} minutes, so this computer no "
            "longer answers",
        )

    def _converse(self, channel: Channel) -> tuple[End, End]:
        greet_as_answering(channel, self.code)
        opening = _expected(channel, "open")
        own, other = channel.connection.getsockname()[0], channel.connection.getpeername()[0]
        run, there = read_run(opening), read(Opened, opening)
        with ExitStack() as stack:
            here = Station(self._context, self._program, own, other, run, is_asking=False)
            try:
                stack.enter_context(here.open())
            except ProbeError as problem:
                channel.send({"failed": str(problem)})
                raise ProtocolError(ProtocolReason.REFUSED, str(problem)) from problem
            channel.send(asdict(here.opened))
            return _obey(channel, here, there)


def _obey(channel: Channel, here: Station, there: Opened) -> tuple[End, End]:
    _expected(channel, "send")
    here.send(there.targets)
    channel.send({})
    _expected(channel, "look")
    here.look(there.source_id)
    channel.send(_with_streams(here))
    here.knock(_streams_of(_expected(channel, "knock")))
    channel.send({})
    found_there = read(End, _expected(channel, "compare").get("end"))
    end = here.end()
    channel.send({"end": as_message(end)})
    return end, found_there


def _expected(channel: Channel, command: str) -> Message:
    message = channel.receive(COMMAND_S)
    if message.get("do") != command:
        raise ProtocolError(
            ProtocolReason.GARBAGE,
            f"{channel.name} sent {str(message.get('do'))!r:.40} instead of {command!r}",
        )
    return message


def _with_streams(here: Station) -> Message:
    return {"streams": [asdict(each) for each in here.own_streams]}


def _streams_of(message: Message) -> tuple[Stream, ...]:
    return read(tuple[Stream, ...], message.get("streams"))
