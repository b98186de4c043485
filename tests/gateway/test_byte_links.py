"""Links by the text of a port: TCP on loopback, and what of Bluetooth needs no radio."""

from __future__ import annotations

import asyncio
import errno
import socket
import threading
from collections.abc import AsyncGenerator, Generator

import pytest
from pylsl import local_clock

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.transports import byte_links
from biosensor_gateway.transports.byte_links import RfcommLink, TcpLink, byte_link
from biosensor_gateway.transports.link import ByteLink
from biosensor_gateway.transports.serial_port import SerialLink
from biosensor_gateway.transports.threads import in_daemon_thread
from tests.rigs.polling import eventually

pytestmark = pytest.mark.nightly

ALL_BYTES = bytes(range(256))
ENDED_WITHIN_S = 20.0
ADDRESS = "00:06:66:AA:BB:CC"


@pytest.fixture(autouse=True)
async def no_thread_is_left() -> AsyncGenerator[None]:
    before = set(threading.enumerate())
    yield
    await eventually(lambda: set(threading.enumerate()) <= before)


class Peer:
    """The other side of one TCP connection."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listener.getsockname()[1])
        self._connection: socket.socket | None = None

    @property
    def connection(self) -> socket.socket:
        if self._connection is None:
            self._connection, _ = self.listener.accept()
            self._connection.settimeout(ENDED_WITHIN_S)
        return self._connection

    def heard(self) -> bytes:
        """Read until the other side has said everything."""
        data = b""
        while piece := self.connection.recv(65536):
            data += piece
        return data

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self.listener.close()


@pytest.fixture
def peer() -> Generator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture
async def link(peer: Peer) -> AsyncGenerator[ByteLink]:
    opened = byte_link(f"socket://127.0.0.1:{peer.port}")
    await opened.open()
    yield opened
    await close(opened)


async def close(link: ByteLink) -> None:
    await asyncio.wait_for(link.close(), ENDED_WITHIN_S)


async def receive(link: ByteLink, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += (await link.read()).data
    return data


async def open_error(link: ByteLink) -> TransportError:
    with pytest.raises(TransportError) as caught:
        await link.open()
    await close(link)
    return caught.value


async def read_error(link: ByteLink) -> TransportError:
    with pytest.raises(TransportError) as caught:
        await asyncio.wait_for(link.read(), ENDED_WITHIN_S)
    return caught.value


@pytest.mark.parametrize(
    ("port", "kind"),
    [
        ("socket://127.0.0.1:5000", TcpLink),
        ("socket://[::1]:5000", TcpLink),
        ("socket://lab-pc.example:5000", TcpLink),
        (ADDRESS, RfcommLink),
        (ADDRESS.lower(), RfcommLink),
        ("COM7", SerialLink),
        ("/dev/rfcomm0", SerialLink),
        ("00:06:66:AA:BB", SerialLink),
    ],
)
def test_the_text_says_which_link(port: str, kind: type[ByteLink]) -> None:
    assert type(byte_link(port)) is kind


@pytest.mark.parametrize(
    "port",
    ["socket://", "socket://host", "socket://:5000", "socket://host:0", "socket://host:99999",
     "socket://host:x", "socket://[::1:5000"],
)  # fmt: skip
def test_half_an_address_is_a_wrong_setting(port: str) -> None:
    with pytest.raises(ConfigError, match="HOST:NUMBER") as caught:
        byte_link(port)
    assert caught.value.reason is ConfigReason.WRONG_VALUE


@pytest.mark.seam
async def test_every_byte_passes_both_ways(peer: Peer, link: ByteLink) -> None:
    peer.connection.sendall(ALL_BYTES * 100)
    assert await receive(link, 25600) == ALL_BYTES * 100
    for value in ALL_BYTES:
        link.write(bytes([value]))
    closing = asyncio.create_task(close(link))
    assert await in_daemon_thread(peer.heard) == ALL_BYTES
    peer.connection.close()
    await closing


@pytest.mark.nightly
async def test_what_was_written_before_closing_is_sent_though_bytes_are_unread(
    peer: Peer, link: ByteLink
) -> None:
    peer.connection.sendall(bytes(100_000))
    link.write(b"stop, ")
    link.write(b"please")
    closing = asyncio.create_task(close(link))
    assert await in_daemon_thread(peer.heard) == b"stop, please"
    await closing


@pytest.mark.nightly
async def test_bytes_carry_the_lsl_time_of_their_arrival(peer: Peer, link: ByteLink) -> None:
    before = local_clock()
    peer.connection.sendall(b"x")
    # Read later: the stamp is that of the arrival, not of the reading.
    await asyncio.sleep(2.0)
    after = local_clock()
    data, arrival = await link.read()
    assert data == b"x"
    assert before <= arrival < after - 0.5


@pytest.mark.nightly
async def test_commands_are_sent_at_once_and_a_dead_peer_is_noticed(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[socket.socket] = []
    create_connection = socket.create_connection

    def noted(address: tuple[str, int], timeout: float) -> socket.socket:
        made.append(create_connection(address, timeout))
        return made[0]

    monkeypatch.setattr(byte_links.socket, "create_connection", noted)
    link = TcpLink("127.0.0.1", peer.port)
    await link.open()
    assert made[0].getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    assert made[0].getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    await close(link)


@pytest.mark.nightly
async def test_a_hang_up_is_told_after_everything_that_had_arrived(
    peer: Peer, link: ByteLink
) -> None:
    peer.connection.sendall(ALL_BYTES)
    peer.connection.close()
    assert await receive(link, 256) == ALL_BYTES
    for _ in range(2):
        error = await read_error(link)
        assert error.reason is TransportReason.LOST
        assert f"127.0.0.1:{peer.port}: the link was cut" in str(error)


@pytest.mark.seam
async def test_a_reset_ends_a_waiting_read(peer: Peer, link: ByteLink) -> None:
    reading = asyncio.create_task(read_error(link))
    await asyncio.sleep(0.05)
    no_farewell = b"\1\0\0\0\0\0\0\0"
    peer.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, no_farewell)
    peer.connection.close()
    assert (await reading).reason is TransportReason.LOST


@pytest.mark.nightly
async def test_a_quiet_link_stays_open(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(byte_links, "WRITE_TIMEOUT_S", 0.02)
    link = TcpLink("127.0.0.1", peer.port)
    await link.open()
    await asyncio.sleep(0.3)
    peer.connection.sendall(b"x")
    assert (await link.read()).data == b"x"
    await close(link)


@pytest.mark.nightly
async def test_a_write_that_nobody_takes_ends_the_link(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_links, "WRITE_TIMEOUT_S", 0.1)
    link = TcpLink("127.0.0.1", peer.port)
    await link.open()
    assert peer.connection
    link.write(bytes(50_000_000))
    assert (await read_error(link)).reason is TransportReason.LOST
    await close(link)


@pytest.mark.nightly
async def test_closing_waits_neither_for_a_write_nor_for_the_other_side(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_links, "WRITE_TIMEOUT_S", 2 * ENDED_WITHIN_S)
    monkeypatch.setattr(byte_links, "CLOSE_TIMEOUT_S", 0.1)
    monkeypatch.setattr(byte_links, "FAREWELL_S", 0.1)
    link = TcpLink("127.0.0.1", peer.port)
    await link.open()
    assert peer.connection
    link.write(bytes(50_000_000))
    await close(link)


@pytest.mark.nightly
async def test_a_link_can_be_closed_in_every_state(peer: Peer) -> None:
    await close(TcpLink("127.0.0.1", peer.port))
    link = TcpLink("127.0.0.1", peer.port)
    await link.open()
    peer.connection.close()
    await read_error(link)
    await close(link)
    await close(link)


@pytest.mark.nightly
async def test_nobody_listening_is_absent(peer: Peer) -> None:
    peer.listener.close()
    error = await open_error(TcpLink("127.0.0.1", peer.port))
    assert error.reason is TransportReason.ABSENT
    assert f"127.0.0.1:{peer.port}: nothing listens there" in str(error)


@pytest.mark.parametrize(
    ("raised", "reason", "words"),
    [
        (OSError(errno.ECONNREFUSED, "x"), TransportReason.ABSENT, "nothing listens"),
        (OSError(errno.EHOSTUNREACH, "x"), TransportReason.ABSENT, "does not answer"),
        (TimeoutError("timed out"), TransportReason.ABSENT, "does not answer"),
        (OSError(errno.ENETUNREACH, "x"), TransportReason.ABSENT, "no route to that network"),
        (OSError(errno.EACCES, "x"), TransportReason.DENIED, "firewall"),
        (socket.gaierror(socket.EAI_NONAME, "x"), TransportReason.ABSENT, "no such host"),
        (OSError(errno.EIO, "something odd"), TransportReason.ABSENT, "something odd"),
    ],
)
async def test_what_the_system_says_of_tcp_becomes_a_reason_and_an_advice(
    monkeypatch: pytest.MonkeyPatch, raised: OSError, reason: TransportReason, words: str
) -> None:
    def refuse(*_: object) -> None:
        raise raised

    monkeypatch.setattr(byte_links.socket, "create_connection", refuse)
    error = await open_error(TcpLink("fe80::1", 5000))
    assert error.reason is reason
    assert words in str(error)
    assert str(error).startswith("[fe80::1]:5000: ")


@pytest.fixture
def slow_connection(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> Generator[threading.Event]:
    """Connections come about only once the event is set."""
    may_connect = threading.Event()

    def slow(*_: object) -> socket.socket:
        may_connect.wait(ENDED_WITHIN_S)
        made = socket.socket()
        made.connect(("127.0.0.1", peer.port))
        return made

    monkeypatch.setattr(byte_links.socket, "create_connection", slow)
    yield may_connect
    may_connect.set()


@pytest.mark.nightly
@pytest.mark.parametrize("is_stopped", [False, True])
async def test_a_connection_that_comes_too_late_is_not_held(
    peer: Peer, slow_connection: threading.Event, monkeypatch: pytest.MonkeyPatch, is_stopped: bool
) -> None:
    monkeypatch.setattr(byte_links, "OPEN_TIMEOUT_S", ENDED_WITHIN_S if is_stopped else 0.05)
    link = TcpLink("127.0.0.1", peer.port)
    opening = asyncio.create_task(link.open())
    if is_stopped:
        await asyncio.sleep(0.05)
        opening.cancel()
    with pytest.raises(asyncio.CancelledError if is_stopped else TransportError):
        await opening
    await close(link)
    slow_connection.set()
    # Nothing was said, and the connection has ended.
    assert await in_daemon_thread(peer.heard) == b""


@pytest.fixture
def bluetooth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Python that knows Bluetooth sockets, whatever this one was built with."""
    monkeypatch.setattr(socket, "AF_BLUETOOTH", 31, raising=False)
    monkeypatch.setattr(socket, "BTPROTO_RFCOMM", 3, raising=False)


async def test_a_python_without_bluetooth_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(socket, "AF_BLUETOOTH", raising=False)
    error = await open_error(byte_link(ADDRESS))
    assert error.reason is TransportReason.UNAVAILABLE
    assert "set the serial port" in str(error)


class BluetoothSocket:
    """Fails to connect; notes what it was asked to do."""

    def __init__(self, error: OSError) -> None:
        self._error = error
        self.address: object = None
        self.closed = False

    def connect(self, address: object) -> None:
        self.address = address
        raise self._error

    def close(self) -> None:
        self.closed = True


@pytest.mark.usefixtures("bluetooth")
@pytest.mark.parametrize(
    ("code", "reason", "words"),
    [
        (errno.EHOSTDOWN, TransportReason.ABSENT, "switch it on"),
        (errno.ETIMEDOUT, TransportReason.ABSENT, "switch it on"),
        (errno.EADDRNOTAVAIL, TransportReason.ABSENT, "switch it on"),
        (errno.ECONNREFUSED, TransportReason.ABSENT, "off and on"),
        (errno.EBUSY, TransportReason.BUSY, "another program"),
        (errno.EADDRINUSE, TransportReason.BUSY, "another program"),
        (errno.EACCES, TransportReason.DENIED, "pair it"),
        (errno.EHOSTUNREACH, TransportReason.UNAVAILABLE, "no Bluetooth"),
        (errno.ENETDOWN, TransportReason.UNAVAILABLE, "no Bluetooth"),
        (errno.EIO, TransportReason.ABSENT, "something odd"),
    ],
)
async def test_what_the_system_says_of_bluetooth_becomes_a_reason_and_an_advice(
    monkeypatch: pytest.MonkeyPatch, code: int, reason: TransportReason, words: str
) -> None:
    made = BluetoothSocket(OSError(code, "something odd"))

    def make(*_: object) -> BluetoothSocket:
        return made

    monkeypatch.setattr(byte_links.socket, "socket", make)
    error = await open_error(RfcommLink(ADDRESS, channel=2))
    assert error.reason is reason
    assert words in str(error)
    assert str(error).startswith(f"{ADDRESS}: ")
    assert made.address == (ADDRESS, 2)
    assert made.closed


@pytest.mark.usefixtures("bluetooth")
async def test_a_system_without_bluetooth_sockets_has_no_bluetooth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EAFNOSUPPORT, "x")

    monkeypatch.setattr(byte_links.socket, "socket", refuse)
    error = await open_error(RfcommLink(ADDRESS))
    assert error.reason is TransportReason.UNAVAILABLE


@pytest.mark.nightly
@pytest.mark.usefixtures("bluetooth")
async def test_a_bluetooth_connection_carries_bytes_and_times_as_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = socket.socketpair()

    def connected(_: RfcommLink) -> socket.socket:
        return ours

    monkeypatch.setattr(RfcommLink, "_connected", connected)
    link = byte_link(ADDRESS)
    await link.open()
    theirs.sendall(b"data")
    assert (await link.read()).data == b"data"
    link.write(b"command")
    assert await in_daemon_thread(lambda: theirs.recv(100)) == b"command"
    theirs.close()
    assert (await read_error(link)).reason is TransportReason.LOST
    await close(link)
