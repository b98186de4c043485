"""Sockets that go no further than this process, for unit tests in virtual time.

They stand for TCP and UDP on this computer as Linux has them: a port is refused, taken or free,
a buffer is full, a connection ends, is ended one way, or is reset. Bytes take no time. asyncio,
TLS and libraries use them without knowing: a loop's selector asks them what is ready.
"""

from __future__ import annotations

import errno
import ipaddress
import itertools
import os
import selectors
import socket
import struct
from collections import deque
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import pytest

if TYPE_CHECKING:
    from tests.rigs.virtual_time import VirtualTime

FIRST_NUMBER = 1 << 30
"""File numbers from here on are no files of the system."""
_FIRST_PORT = 40000
_BUFFER_BYTES = 1 << 16
_RESET_AT_CLOSE = struct.pack("ii", 1, 0)
_UNIX: int = getattr(socket, "AF_UNIX", -2)
_FAMILIES = (-1, socket.AF_UNSPEC, socket.AF_INET, socket.AF_INET6, _UNIX)
_ANY, _LOOPBACK = ("0.0.0.0", "::"), ("127.0.0.1", "::1")

_RealSocket = socket.socket
_real_addresses = socket.getaddrinfo
_real_pair = socket.socketpair

Address = tuple[Any, ...]
Buffer = bytes | bytearray | memoryview


class Network:
    """All sockets of a test."""

    def __init__(self, clock: Callable[[], VirtualTime]) -> None:
        self.clock = clock
        self.numbers = itertools.count(FIRST_NUMBER)
        self.sockets: dict[int, MemorySocket] = {}
        self._ports = itertools.count(_FIRST_PORT)

    def ports_of(self, like: MemorySocket, port: int) -> list[MemorySocket]:
        """Return the sockets that have a port, of the same kind as another one."""
        return [
            each
            for each in tuple(self.sockets.values())
            if (each.type, each.family) == (like.type, like.family)
            and each.is_bound
            and each.name[1] == port
        ]

    def free_port(self, like: MemorySocket) -> int:
        """Return a port that nobody has."""
        return next(port for port in self._ports if not self.ports_of(like, port))


_network: Network | None = None


def ready(number: int, events: int) -> int:
    """Return which events have happened to a socket, by its file number."""
    found = None if _network is None else _network.sockets.get(number)
    if found is None:
        return 0
    readable = selectors.EVENT_READ if found.is_readable() else 0
    writable = selectors.EVENT_WRITE if found.is_writable() else 0
    return events & (readable | writable)


class _Pipe:
    """Bytes on their way in one direction of a connection."""

    def __init__(self, room: int) -> None:
        self.data = bytearray()
        self.room = room
        self.has_ended = False
        self.is_reset = False


class MemorySocket:
    """Takes the place of ``socket.socket``; one that is no business of a test is the system's."""

    def __new__(
        cls,
        family: int = -1,
        type: int = -1,  # noqa: A002 - as the system's calls it
        proto: int = -1,
        fileno: int | None = None,
    ) -> Self:
        """Make one in memory, unless it is for a file that is there or for no unit test."""
        if _network is None or fileno is not None or family not in _FAMILIES:
            real: Any = _RealSocket(family, type, proto, fileno)
            return real
        return super().__new__(cls)

    def __init__(
        self,
        family: int = -1,
        type: int = -1,  # noqa: A002 - as the system's calls it
        proto: int = -1,
        fileno: int | None = None,
    ) -> None:
        del fileno
        assert _network is not None
        self._network = _network
        self.family = socket.AF_INET if family in (-1, 0) else socket.AddressFamily(family)
        self.type = socket.SOCK_STREAM if type == -1 else socket.SocketKind(type)
        self.proto = max(proto, 0)
        self.name: Address = (_ANY[self._index], 0)
        self.peer: Address | None = None
        self._timeout = socket.getdefaulttimeout()
        self._options: dict[tuple[int, int], Any] = {}
        self._backlog: deque[MemorySocket] | None = None
        self._incoming: _Pipe | None = None
        self._outgoing: _Pipe | None = None
        self._inbox: deque[tuple[bytes, Address]] = deque()
        self._refused = False
        self._io_refs = 0
        self._closed = False
        self._number = next(_network.numbers)
        _network.sockets[self._number] = self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # What it is.

    @property
    def _index(self) -> int:
        return 1 if self.family == socket.AF_INET6 else 0

    @property
    def is_bound(self) -> bool:
        """Whether it has a port."""
        return bool(self.name[1])

    def fileno(self) -> int:
        """Return its number; -1 once it is closed."""
        return self._number

    def getsockname(self) -> Address:
        """Return its own address."""
        return self._full(self.name)

    def getpeername(self) -> Address:
        """Return the other side's address."""
        if self.peer is None:
            raise _error(errno.ENOTCONN)
        return self._full(self.peer)

    def settimeout(self, value: float | None) -> None:
        """Say how long calls may block."""
        self._timeout = value

    def gettimeout(self) -> float | None:
        """Return how long calls may block."""
        return self._timeout

    timeout = property(gettimeout)

    def setblocking(self, flag: bool) -> None:
        """Say whether calls may block."""
        self._timeout = None if flag else 0.0

    def getblocking(self) -> bool:
        """Return whether calls may block."""
        return self._timeout != 0

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        """Set an option; the ones that matter are SO_REUSEADDR, SO_LINGER and the buffers."""
        self._options[level, option] = value

    def getsockopt(self, level: int, option: int) -> Any:
        """Return an option."""
        return self._option(option) if level == socket.SOL_SOCKET else 0

    def _option(self, option: int) -> Any:
        return self._options.get((socket.SOL_SOCKET, option), 0)

    def _full(self, address: Address) -> Address:
        return (*address[:2], 0, 0) if self._index else tuple(address[:2])

    # Ports.

    def bind(self, address: Address) -> None:
        """Take a port."""
        host, port = self._numeric(address[0]), int(address[1])
        if host not in _ANY and not ipaddress.ip_address(host).is_loopback:
            raise _error(errno.EADDRNOTAVAIL)
        for other in self._network.ports_of(self, port) if port else ():
            both_share = self._option(socket.SO_REUSEADDR) and other._option(socket.SO_REUSEADDR)
            if other._meets(host) and not (both_share and other._backlog is None):
                raise _error(errno.EADDRINUSE)
        self.name = (host, port or self._network.free_port(self))

    def listen(self, backlog: int = 128) -> None:
        """Let others connect."""
        del backlog
        others = self._network.ports_of(self, self.name[1])
        if any(each is not self and each._backlog is not None for each in others):
            raise _error(errno.EADDRINUSE)
        if not self.is_bound:
            self.bind(self.name)
        if self._backlog is None:
            self._backlog = deque()

    def accept(self) -> tuple[MemorySocket, Address]:
        """Return the next connection."""
        self._wait(lambda: bool(self._backlog))
        assert self._backlog
        accepted = self._backlog.popleft()
        return accepted, accepted.getpeername()

    def connect(self, address: Address) -> None:
        """Connect to a listening socket; or to a port, by datagrams."""
        if self.family == _UNIX:
            # Services of the system, such as D-Bus, are not there.
            raise _error(errno.ENOENT)
        host, port = self._numeric(address[0]), int(address[1])
        if host in _ANY:
            host = _LOOPBACK[self._index]
        if not ipaddress.ip_address(host).is_loopback:
            raise _error(errno.ENETUNREACH)
        if not self.is_bound or self.name[0] in _ANY:
            mine = self.name[1] or self._network.free_port(self)
            self.name = (_LOOPBACK[self._index], mine)
        self.peer = (host, port)
        if self.type == socket.SOCK_STREAM:
            self._connect(host, port)

    def connect_ex(self, address: Address) -> int:
        """Connect, and return the number of the error, or 0."""
        try:
            self.connect(address)
        except OSError as error:
            return error.errno or errno.EIO
        return 0

    def _connect(self, host: str, port: int) -> None:
        ports = self._network.ports_of(self, port)
        listening = next(
            (each for each in ports if each._backlog is not None and each._meets(host)), None
        )
        if listening is None:
            raise _error(errno.ECONNREFUSED)
        other = MemorySocket(self.family, self.type, self.proto)
        other._options = dict(listening._options)
        other.name, other.peer = self._full((host, port))[:2], self.name
        self._outgoing = other._incoming = _Pipe(self._room_to(other))
        self._incoming = other._outgoing = _Pipe(other._room_to(self))
        assert listening._backlog is not None
        listening._backlog.append(other)

    def _room_to(self, other: MemorySocket) -> int:
        sent, unread = self._option(socket.SO_SNDBUF), other._option(socket.SO_RCVBUF)
        return (sent or _BUFFER_BYTES) + (unread or _BUFFER_BYTES)

    def _meets(self, host: str) -> bool:
        return self.name[0] == host or self.name[0] in _ANY or host in _ANY

    def _numeric(self, host: str) -> str:
        if host == "":
            return _ANY[self._index]
        if host == "<broadcast>":
            return "255.255.255.255"
        info = _addresses(host, None, family=self.family)
        return str(info[0][4][0])

    # Bytes and datagrams.

    def is_readable(self) -> bool:
        """Whether reading, or accepting, would not block."""
        if self._backlog is not None:
            return bool(self._backlog)
        if self.type == socket.SOCK_DGRAM:
            return bool(self._inbox) or self._refused
        pipe = self._incoming
        return pipe is None or bool(pipe.data) or pipe.has_ended or pipe.is_reset

    def is_writable(self) -> bool:
        """Whether writing would not block."""
        if self.type == socket.SOCK_DGRAM or self._outgoing is None or self._incoming is None:
            return True
        is_over = self._incoming.is_reset or self._outgoing.has_ended
        return is_over or len(self._outgoing.data) < self._outgoing.room

    def recv(self, size: int, flags: int = 0) -> bytes:
        """Return the next bytes; empty once the other side has ended its own."""
        return self.recvfrom(size, flags)[0]

    def recv_into(self, buffer: Buffer, size: int = 0, flags: int = 0) -> int:
        """Read into a buffer."""
        del flags
        return self.recvfrom_into(buffer, size)[0]

    def recvfrom(self, size: int, flags: int = 0) -> tuple[bytes, Address | None]:
        """Return the next bytes, and who sent them."""
        if self.type == socket.SOCK_DGRAM:
            self._wait(self.is_readable)
            self._raise_refusal()
            data, sender = self._inbox.popleft()
            return data[:size], self._full(sender)
        pipe = self._incoming
        if pipe is None:
            raise _error(errno.ENOTCONN)
        self._wait(self.is_readable)
        if pipe.is_reset and not pipe.data:
            raise _error(errno.ECONNRESET)
        data = bytes(pipe.data[:size])
        if not flags & socket.MSG_PEEK:
            del pipe.data[:size]
        return data, None

    def recvfrom_into(self, buffer: Buffer, size: int = 0) -> tuple[int, Address | None]:
        """Read into a buffer, and return who sent it."""
        room = memoryview(buffer).cast("B")
        data, sender = self.recvfrom(size or len(room))
        room[: len(data)] = data
        return len(data), sender

    def send(self, data: Buffer, flags: int = 0) -> int:
        """Send what there is room for, and return how much."""
        del flags
        if self.type == socket.SOCK_DGRAM:
            if self.peer is None:
                raise _error(errno.EDESTADDRREQ)
            self._raise_refusal()
            self._refused = not self._send_datagram(bytes(data), self.peer)
            return len(bytes(data))
        if self._outgoing is None or self._incoming is None:
            raise _error(errno.ENOTCONN)
        if self._outgoing.has_ended or self._incoming.is_reset:
            raise _error(errno.EPIPE)
        self._wait(self.is_writable)
        taken = bytes(data)[: self._outgoing.room - len(self._outgoing.data)]
        if self._outgoing.is_reset:
            # Nobody is there to read it, which one is told after the first try.
            self._incoming.is_reset = True
        else:
            self._outgoing.data += taken
        return len(taken)

    def sendall(self, data: Buffer, flags: int = 0) -> None:
        """Send all of it."""
        rest = memoryview(bytes(data))
        while rest:
            rest = rest[self.send(rest, flags) :]

    def sendmsg(self, buffers: Iterable[Buffer]) -> int:
        """Send what there is room for, out of several buffers."""
        return self.send(b"".join(bytes(each) for each in buffers))

    def sendto(self, data: Buffer, *flags_and_address: Any) -> int:
        """Send a datagram; where nobody listens, nothing happens."""
        host, port, *_ = flags_and_address[-1]
        if not self.is_bound:
            self.bind(self.name)
        self._send_datagram(bytes(data), (self._numeric(host), int(port)))
        return len(bytes(data))

    def _send_datagram(self, data: bytes, address: Address) -> bool:
        host, port = address
        to_all = host == "255.255.255.255"
        if to_all and not self._option(socket.SO_BROADCAST):
            raise _error(errno.EACCES)
        if not to_all and not ipaddress.ip_address(host).is_loopback and host not in _ANY:
            raise _error(errno.ENETUNREACH)
        mine = (_LOOPBACK[self._index] if self.name[0] in _ANY else self.name[0], self.name[1])
        found = [each for each in self._network.ports_of(self, port) if to_all or each._meets(host)]
        for each in found:
            if each.peer in (None, mine):
                each._take(data, mine)
        return bool(found)

    def _take(self, data: bytes, sender: Address) -> None:
        room = self._option(socket.SO_RCVBUF) or _BUFFER_BYTES
        if sum(len(each) for each, _ in self._inbox) + len(data) <= room:
            self._inbox.append((data, sender))

    def _raise_refusal(self) -> None:
        if self._refused:
            self._refused = False
            raise _error(errno.ECONNREFUSED)

    # The end.

    def shutdown(self, how: int) -> None:
        """End one way or both."""
        if self._outgoing is None or self._incoming is None:
            raise _error(errno.ENOTCONN)
        if how in (socket.SHUT_WR, socket.SHUT_RDWR):
            self._outgoing.has_ended = True
        if how in (socket.SHUT_RD, socket.SHUT_RDWR):
            self._incoming.has_ended = True

    def close(self) -> None:
        """End it, and give its port back; files that were made of it go on till they are closed."""
        self._closed = True
        if self._io_refs <= 0:
            self._real_close()

    def detach(self) -> int:
        """Close it for good."""
        self._io_refs = 0
        self.close()
        return -1

    makefile = _RealSocket.makefile
    _decref_socketios = _RealSocket._decref_socketios  # pyright: ignore - a file calls it

    def _real_close(self) -> None:
        if self._number == -1:
            return
        del self._network.sockets[self._number]
        self._number = -1
        for each in self._backlog or ():
            each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_AT_CLOSE)
            each.close()
        if self._outgoing is not None and self._incoming is not None:
            breaks_off = self._option(socket.SO_LINGER) == _RESET_AT_CLOSE
            if breaks_off or self._incoming.data:
                self._outgoing.is_reset = True
            self._outgoing.has_ended = True
            # What is sent to it from now on is answered by a reset.
            self._incoming.is_reset = True
            self._incoming.data.clear()

    def _wait(self, is_over: Callable[[], bool]) -> None:
        if self._number == -1:
            raise _error(errno.EBADF)
        if is_over():
            return
        if self._timeout == 0:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        clock = self._network.clock()
        if not clock.wait_in_turn(self._timeout, lambda: is_over() or self._number == -1):
            raise TimeoutError("timed out")
        if self._number == -1:
            raise _error(errno.EBADF)


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


def _addresses(host: Any, port: Any, *arguments: Any, **named: Any) -> list[Any]:
    """Return the addresses of this computer alone; nobody else is asked."""
    if isinstance(host, bytes):
        host = host.decode()
    if host == "localhost":
        host = _LOOPBACK[1 if named.get("family") == socket.AF_INET6 else 0]
    if host is not None:
        try:
            ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known") from None
    return _real_addresses(host, port, *arguments, **named)


def _pair(*arguments: Any) -> tuple[socket.socket, socket.socket]:
    """Return a pair of the system's, with which threads wake a loop."""
    with pytest.MonkeyPatch.context() as patch:
        # Windows makes it of two sockets.
        patch.setattr(socket, "socket", _RealSocket)
        return _real_pair(*arguments)


@contextmanager
def sockets_in_memory(clock: Callable[[], VirtualTime]) -> Generator[Network]:
    """Have all sockets that are made meanwhile in memory, by the clock that is the test's."""
    global _network  # noqa: PLW0603 - as sockets are the process's
    _network = Network(clock)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket, "socket", MemorySocket)
        patch.setattr(socket, "getaddrinfo", _addresses)
        patch.setattr(socket, "socketpair", _pair)
        yield _network
    _network = None
