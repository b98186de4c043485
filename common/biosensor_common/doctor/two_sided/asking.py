"""The side that asks: connects to the other computer and leads through the test."""

from __future__ import annotations

import socket
from collections.abc import Callable

from biosensor_common.doctor.check import Context
from biosensor_common.doctor.two_sided import handshake
from biosensor_common.doctor.two_sided.channel import Channel, Message
from biosensor_common.doctor.two_sided.code import nonce, read_code
from biosensor_common.doctor.two_sided.commands import (
    Command,
    source_id_of,
    streams_of,
    targets_of,
    with_streams,
    with_targets,
)
from biosensor_common.doctor.two_sided.facts import End, as_message, read_end
from biosensor_common.doctor.two_sided.station import Station
from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

CONNECT_S = 5.0
ANSWER_S = 60.0
"""Both take as long, so the slower one of two computers is waited for."""


class UnreachedError(TransportError):
    """The other computer does not take the connection.

    ``ABSENT`` if it refuses, ``SILENT`` if nothing comes back, ``UNAVAILABLE`` if it is unknown.
    """


def ask(context: Context, program: str, host: str, port: int, code: str) -> tuple[End, End]:
    """Test the network between this computer and another one, which answers.

    Returns
    -------
    here, there
        What each of them has found out.

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
        handshake.ask(channel, typed)
        own, other = connection.getsockname()[0], connection.getpeername()[0]
        run = nonce()
        with Station(context, program, own, other, run, is_asking=True) as here:
            return _led_through(channel, here, run)


def _led_through(channel: Channel, here: Station, run: str) -> tuple[End, End]:
    opened = with_targets(here.targets) | {"source_id": here.source_id, "run": run}
    reply = _both(channel, Command.OPEN, opened, lambda: None)
    targets, source_id = targets_of(reply), source_id_of(reply)
    _both(channel, Command.SEND, {}, lambda: here.send(targets))
    reply = _both(channel, Command.LOOK, {}, lambda: here.look(source_id))
    theirs = streams_of(reply)
    _both(channel, Command.KNOCK, with_streams(here.own_streams), lambda: here.knock(theirs))
    # What is on its way to this computer was sent before the last reply.
    end = here.end()
    reply = _both(channel, Command.COMPARE, {"end": as_message(end)}, lambda: None)
    return end, read_end(reply.get("end"))


def _both(channel: Channel, do: Command, details: Message, here: Callable[[], None]) -> Message:
    """Have the other one do something, and do the same here meanwhile."""
    channel.send({"do": do.value, **details})
    here()
    reply = channel.receive(ANSWER_S)
    if "failed" in reply:
        raise ProtocolError(
            ProtocolReason.REFUSED,
            f"{channel.name} cannot do its part: {str(reply['failed'])[:300]}",
        )
    return reply


def _connected(host: str, port: int) -> socket.socket:
    try:
        address = socket.gethostbyname(host)
        return socket.create_connection((address, port), CONNECT_S)
    except (socket.gaierror, UnicodeError) as error:
        raise UnreachedError(TransportReason.UNAVAILABLE, f"{host} has no IPv4 address") from error
    except ConnectionRefusedError as error:
        raise UnreachedError(
            TransportReason.ABSENT, f"{host} is there, but refuses TCP {port}"
        ) from error
    except TimeoutError as error:
        raise UnreachedError(
            TransportReason.SILENT, f"nothing comes back from TCP {port} of {host}"
        ) from error
    except OSError as error:
        # No route, for instance, or the neighbour does not answer.
        raise UnreachedError(
            TransportReason.SILENT,
            f"TCP {port} of {host} cannot be reached ({error.strerror or error})",
        ) from error
