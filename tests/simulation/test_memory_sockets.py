"""Sockets in memory do as the system's do: each test tries both, the real ones at night."""

from __future__ import annotations

import asyncio
import errno
import socket
import struct
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest

from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.byte_links import byte_link

HERE = "127.0.0.1"
DATA = bytes(range(256))
RESET_AT_CLOSE = struct.pack("ii", 1, 0)
LIMIT_S = 10.0

both = pytest.mark.parametrize(
    "where", ["in memory", pytest.param("real", marks=pytest.mark.nightly)]
)
pytestmark = [
    both,
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]


@contextmanager
def connection() -> Generator[tuple[socket.socket, socket.socket]]:
    """Yield both ends of a connection, which wait with patience."""
    with socket.create_server((HERE, 0)) as listening:
        client = socket.create_connection(listening.getsockname())
        server, _ = listening.accept()
    with client, server:
        client.settimeout(LIMIT_S)
        server.settimeout(LIMIT_S)
        yield client, server


def errno_of(call: Any, *arguments: Any) -> int | None:
    with pytest.raises(OSError) as raised:
        call(*arguments)
    return raised.value.errno


def test_it_is_what_it_says(where: str) -> None:
    with connection() as (client, server):
        assert isinstance(client, type(server))
        assert (type(client).__name__ == "MemorySocket") == (where == "in memory")
        assert client.getpeername() == server.getsockname()
        assert server.getpeername() == client.getsockname()


def test_bytes_pass_both_ways_and_may_be_looked_at_before(where: str) -> None:
    with connection() as (client, server):
        client.sendall(DATA)
        assert server.recv(1, socket.MSG_PEEK) == DATA[:1]
        assert server.recv(1000) == DATA
        server.sendall(DATA)
        room = bytearray(1000)
        assert client.recv_into(room) == len(DATA)
        assert room.startswith(DATA)


def test_one_way_may_end_before_the_other(where: str) -> None:
    with connection() as (client, server):
        client.sendall(b"last words")
        client.shutdown(socket.SHUT_WR)
        assert errno_of(client.send, b"more") == errno.EPIPE
        assert server.recv(1000) == b"last words"
        assert server.recv(1000) == b""
        server.sendall(b"still heard")
        assert client.recv(1000) == b"still heard"


def test_a_connection_that_is_broken_off_is_reset(where: str) -> None:
    with connection() as (client, server):
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_CLOSE)
        client.close()
        assert errno_of(server.recv, 1000) == errno.ECONNRESET


def test_who_closes_with_bytes_unread_resets_the_connection(where: str) -> None:
    with connection() as (client, server):
        server.sendall(b"never read")
        assert client.recv(1, socket.MSG_PEEK)
        client.close()
        assert errno_of(server.recv, 1000) == errno.ECONNRESET


def test_a_buffer_is_full_once_and_has_room_again(where: str) -> None:
    with connection() as (client, server):
        client.setblocking(False)
        sent = 0
        with pytest.raises(BlockingIOError):
            while True:
                sent += client.send(bytes(1 << 16))
        client.settimeout(0.0)
        read = 0
        while read < sent:
            read += len(server.recv(1 << 16))
        assert read == sent
        assert client.send(b"x") == 1


def test_a_port_is_refused_free_or_taken(where: str) -> None:
    with socket.create_server((HERE, 0)) as listening:
        place = listening.getsockname()
        with socket.socket() as second:
            second.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            assert errno_of(second.bind, place) == errno.EADDRINUSE
    with socket.socket() as client:
        assert errno_of(client.connect, place) == errno.ECONNREFUSED
    with socket.create_server(place) as again:
        assert again.getsockname() == place


def test_a_port_may_be_kept_beside_the_one_that_listens(where: str) -> None:
    with socket.socket() as kept, socket.socket() as listening:
        for each in (kept, listening):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        kept.bind((HERE, 0))
        listening.bind(kept.getsockname())
        listening.listen()
        with socket.create_connection(kept.getsockname()) as client:
            assert client.getpeername() == kept.getsockname()


def test_datagrams_stay_whole_and_name_their_sender(where: str) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        one.bind((HERE, 0))
        one.settimeout(LIMIT_S)
        for data in (b"first", b"", b"third"):
            other.sendto(data, one.getsockname())
        received = [one.recvfrom(100) for _ in range(3)]
        assert [data for data, _ in received] == [b"first", b"", b"third"]
        assert {port for _, (_, port) in received} == {other.getsockname()[1]}


def test_a_connected_sender_is_told_that_nobody_listens(where: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HERE, 0))
        place = free.getsockname()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(place)
        sender.send(b"to nobody")
        assert errno_of(sender.send, b"again") == errno.ECONNREFUSED


def test_a_read_that_takes_too_long_ends(where: str) -> None:
    with connection() as (client, _):
        client.settimeout(0.1)
        begun_s = LSL_CLOCK()
        with pytest.raises(TimeoutError):
            client.recv(1)
        assert LSL_CLOCK() - begun_s > 0.09


async def test_streams_of_asyncio_go_through_them(where: str) -> None:
    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.read())
        writer.close()

    server = await asyncio.start_server(echo, "localhost", 0)
    port = server.sockets[0].getsockname()[1]
    reader, writer = await asyncio.open_connection(server.sockets[0].getsockname()[0], port)
    # More than the buffers hold.
    writer.write(DATA * 10_000)
    writer.write_eof()
    assert await reader.read() == DATA * 10_000
    writer.close()
    await writer.wait_closed()
    server.close()


async def test_a_link_stamps_when_bytes_come(where: str) -> None:
    async def speak(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        del reader
        for data in (b"one", b"two"):
            await asyncio.sleep(0.5)
            writer.write(data)
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_server(speak, HERE, 0)
    link = byte_link(f"socket://{HERE}:{server.sockets[0].getsockname()[1]}")
    begun_s = LSL_CLOCK()
    await link.open()
    first, second = await link.read(), await link.read()
    assert (first.data, second.data) == (b"one", b"two")
    waits_s = [first.arrival - begun_s, second.arrival - first.arrival]
    if where == "in memory":
        assert waits_s == pytest.approx([0.5, 0.5], abs=1e-6)
    else:
        assert min(waits_s) > 0
    await link.close()
    server.close()
    await server.wait_closed()
