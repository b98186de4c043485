"""The WebSocket link against real servers with real certificates."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import logging
import ssl
from collections.abc import AsyncGenerator, Awaitable, Callable
from pathlib import Path

import pytest
import trustme
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from websockets.asyncio.server import Server, ServerConnection, serve

from biosensor_common.errors import ConfigError, GatewayError, TransportError, TransportReason
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports import websocket as module
from biosensor_gateway.transports.websocket import WebSocketLink, tls_context
from tests.rigs.polling import eventually

Handler = Callable[[ServerConnection], Awaitable[None]]

LONG_AGO = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
def ca_file(authority: trustme.CA, tmp_path: Path) -> str:
    path = tmp_path / "ca.pem"
    authority.cert_pem.write_to_path(path)
    return str(path)


def identified(certificate: trustme.LeafCert) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    with certificate.private_key_and_cert_chain_pem.tempfile() as identity:
        context.load_cert_chain(identity)
    return context


@contextlib.asynccontextmanager
async def serving(handler: Handler, context: ssl.SSLContext) -> AsyncGenerator[tuple[Server, str]]:
    async with serve(handler, "localhost", 0, ssl=context, ping_interval=None) as server:
        yield server, f"wss://localhost:{server.sockets[0].getsockname()[1]}"


@contextlib.asynccontextmanager
async def linked(
    authority: trustme.CA, ca_file: str, handler: Handler
) -> AsyncGenerator[tuple[WebSocketLink, Server]]:
    async with serving(handler, identified(authority.issue_cert("localhost"))) as (server, url):
        link = WebSocketLink(url, ca_file)
        await link.open()
        try:
            yield link, server
        finally:
            await link.close()


async def stay(socket: ServerConnection) -> None:
    await socket.wait_closed()


async def refusal(url: str, ca_file: str) -> GatewayError:
    link = WebSocketLink(url, ca_file)
    with pytest.raises(GatewayError) as raised:
        await link.open()
    await link.close()
    return raised.value


async def end_of(link: WebSocketLink) -> TransportError:
    with pytest.raises(TransportError) as raised:
        while True:
            await link.read()
    return raised.value


@pytest.mark.nightly
async def test_the_scheme_may_be_in_capitals(authority: trustme.CA, ca_file: str) -> None:
    async with serving(stay, identified(authority.issue_cert("localhost"))) as (_, url):
        link = WebSocketLink(url.replace("wss", "WSS"), ca_file)
        await link.open()
        await link.close()


@pytest.mark.seam
async def test_messages_go_both_ways_in_order_with_their_time_of_arrival(
    authority: trustme.CA, ca_file: str
) -> None:
    async def echo(socket: ServerConnection) -> None:
        async for message in socket:
            await socket.send(message)

    before = LSL_CLOCK()
    async with linked(authority, ca_file, echo) as (link, _):
        for number in range(50):
            await link.send(f"message {number} ä")
        received = [await link.read() for _ in range(50)]
    assert [each.text for each in received] == [f"message {number} ä" for number in range(50)]
    arrivals = [each.arrival for each in received]
    assert before <= arrivals[0]
    assert arrivals == sorted(arrivals)
    assert arrivals[-1] <= LSL_CLOCK()


async def test_large_and_fragmented_messages_are_whole_and_binary_ones_are_counted(
    authority: trustme.CA, ca_file: str
) -> None:
    async def talk(socket: ServerConnection) -> None:
        await socket.send(b"\x00binary")
        await socket.send("x" * 2_000_000)
        await socket.send(["in ", "three ", "pieces"])
        await socket.wait_closed()

    async with linked(authority, ca_file, talk) as (link, _):
        assert len((await link.read()).text) == 2_000_000
        assert (await link.read()).text == "in three pieces"
        assert link.dropped == 1


@pytest.mark.seam
@pytest.mark.parametrize("wrong", ["authority", "name", "expired"])
async def test_a_wrong_certificate_is_denied_and_the_advice_says_what_to_do(
    authority: trustme.CA, ca_file: str, wrong: str
) -> None:
    leaf = {
        "authority": lambda: trustme.CA().issue_cert("localhost"),
        "name": lambda: authority.issue_cert("cortex.example"),
        "expired": lambda: authority.issue_cert("localhost", not_after=LONG_AGO),
    }[wrong]()
    async with serving(stay, identified(leaf)) as (server, url):
        error = await refusal(url, ca_file)
        assert not server.connections
    assert error.reason is TransportReason.DENIED
    assert "certificate" in str(error)
    assert "set ca_file" in str(error)


async def test_nobody_is_trusted_without_a_file_or_the_system(authority: trustme.CA) -> None:
    async with serving(stay, identified(authority.issue_cert("localhost"))) as (_, url):
        assert (await refusal(url, "")).reason is TransportReason.DENIED


async def test_a_root_without_key_usage_is_good_enough_for_newer_pythons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = ssl.create_default_context

    def as_in_python_3_13(*arguments: object, **named: str | None) -> ssl.SSLContext:
        assert not arguments
        context = make(cafile=named["cafile"])
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        return context

    server_context = lenient_identity(tmp_path)
    monkeypatch.setattr(ssl, "create_default_context", as_in_python_3_13)
    async with serving(stay, server_context) as (_, url):
        link = WebSocketLink(url, str(tmp_path / "root.pem"))
        await link.open()
        await link.close()


def lenient_identity(folder: Path) -> ssl.SSLContext:
    """Make a root as the vendor's, without key usage, and a server certificate below it."""
    root_key, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    root_name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "root")])
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    begin, end = LONG_AGO, LONG_AGO.replace(year=2060)
    basic = x509.BasicConstraints(ca=True, path_length=None)
    draft = x509.CertificateBuilder().not_valid_before(begin).not_valid_after(end)
    root = (
        draft.subject_name(root_name)
        .issuer_name(root_name)
        .public_key(root_key.public_key())
        .serial_number(1)
        .add_extension(basic, critical=True)
        .sign(root_key, hashes.SHA256())
    )
    leaf = (
        draft.subject_name(name)
        .issuer_name(root_name)
        .public_key(key.public_key())
        .serial_number(2)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .sign(root_key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    (folder / "root.pem").write_bytes(root.public_bytes(pem))
    (folder / "leaf.pem").write_bytes(
        leaf.public_bytes(pem)
        + key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "leaf.pem")
    return context


def test_certificate_and_name_are_checked(ca_file: str) -> None:
    context = tls_context(ca_file)
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert context.check_hostname
    assert not context.verify_flags & ssl.VERIFY_X509_STRICT


@pytest.mark.parametrize("content", [None, "", "no certificate"])
async def test_a_file_without_a_certificate_is_a_wrong_setting(
    tmp_path: Path, content: str | None
) -> None:
    path = tmp_path / "ca.pem"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match="ca_file"):
        await WebSocketLink("wss://localhost:1", str(path)).open()


@pytest.mark.parametrize("url", ["wss://", "https://localhost:1", "wss://localhost:99999"])
async def test_an_impossible_url_is_a_wrong_setting(url: str, ca_file: str) -> None:
    assert isinstance(await refusal(url, ca_file), ConfigError)


async def test_a_refused_connection_is_an_absent_service(
    unused_tcp_port: int, ca_file: str
) -> None:
    error = await refusal(f"wss://localhost:{unused_tcp_port}", ca_file)
    assert error.reason is TransportReason.ABSENT
    assert str(unused_tcp_port) in str(error)


async def answered_with(answer: bytes | None, ca_file: str) -> GatewayError:
    """Open a link to a TCP server without TLS; None leaves it without an answer."""

    over = asyncio.Event()

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        if answer is None:
            await reader.read()
        else:
            writer.write(answer)
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
        over.set()

    async with await asyncio.start_server(talk, "localhost", 0) as server:
        error = await refusal(f"wss://localhost:{server.sockets[0].getsockname()[1]}", ca_file)
        await over.wait()
        return error


async def test_what_speaks_no_tls_is_not_the_service(ca_file: str) -> None:
    error = await answered_with(b"HTTP/1.1 200 OK\r\n\r\n", ca_file)
    assert error.reason is TransportReason.UNAVAILABLE


async def test_who_hangs_up_or_keeps_silent_while_connecting_is_absent(
    ca_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (await answered_with(b"", ca_file)).reason is TransportReason.ABSENT
    monkeypatch.setattr(module, "OPEN_TIMEOUT_S", 0.3)
    assert (await answered_with(None, ca_file)).reason is TransportReason.ABSENT


@pytest.mark.parametrize("code", [1000, 1001, 1011])
async def test_a_close_is_a_loss_after_everything_that_was_said(
    authority: trustme.CA, ca_file: str, code: int
) -> None:
    async def leave(socket: ServerConnection) -> None:
        await socket.send("last words")
        await socket.close(code, "a reason that quotes a secret")

    async with linked(authority, ca_file, leave) as (link, _):
        assert (await link.read()).text == "last words"
        error = await end_of(link)
        assert error.reason is TransportReason.LOST
        assert str(code) in str(error)
        assert "secret" not in str(error)
        assert await end_of(link) is error
        with pytest.raises(TransportError):
            await link.send("too late")


async def test_an_abort_is_a_loss(authority: trustme.CA, ca_file: str) -> None:
    async def vanish(socket: ServerConnection) -> None:
        socket.transport.abort()

    async with linked(authority, ca_file, vanish) as (link, _):
        assert (await end_of(link)).reason is TransportReason.LOST


async def test_a_peer_that_answers_no_ping_is_lost(
    authority: trustme.CA, ca_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def freeze(socket: ServerConnection) -> None:
        socket.transport.pause_reading()
        await socket.wait_closed()

    monkeypatch.setattr(module, "PING_INTERVAL_S", 0.1)
    monkeypatch.setattr(module, "PING_TIMEOUT_S", 0.1)
    async with linked(authority, ca_file, freeze) as (link, server):
        assert "1011" in str(await end_of(link))
        await abort_all(server)


async def abort_all(server: Server) -> None:
    for socket in server.connections:
        socket.transport.abort()


async def test_closing_does_not_wait_for_a_peer_that_reads_nothing(
    authority: trustme.CA, ca_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def freeze(socket: ServerConnection) -> None:
        socket.transport.pause_reading()
        await socket.wait_closed()

    # So that only the link's own limit can end it.
    monkeypatch.setattr(module, "HANDSHAKE_OF_CLOSE_S", 3600.0)
    async with linked(authority, ca_file, freeze) as (link, server):
        sending = asyncio.create_task(link.send("x" * 30_000_000))
        await asyncio.sleep(0.1)
        await link.close()
        await asyncio.gather(sending, return_exceptions=True)
        assert (await end_of(link)).reason is TransportReason.LOST
        await abort_all(server)


async def test_a_slow_consumer_neither_stalls_the_socket_nor_loses_its_pongs(
    authority: trustme.CA,
    ca_file: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sent = 0

    async def flood(socket: ServerConnection) -> None:
        nonlocal sent
        while sent < 20_000:
            await socket.send(f"{sent:06}{'x' * 994}")
            sent += 1
        await socket.wait_closed()

    monkeypatch.setattr(module, "PING_INTERVAL_S", 0.05)
    monkeypatch.setattr(module, "PING_TIMEOUT_S", 10.0)
    monkeypatch.setattr(module, "KEPT_BYTES", 1_000_000)
    async with linked(authority, ca_file, flood) as (link, _):
        await eventually(lambda: sent == 20_000)
        # Each message counts with what it takes besides its text.
        kept = 1_000_000 // (1000 + 256)
        await eventually(lambda: link.dropped >= 20_000 - kept)
        numbers = [int((await link.read()).text[:6]) for _ in range(kept)]
        # The newest, all of them, in order; and the connection stands.
        assert numbers == list(range(20_000 - kept, 20_000))
        assert link.dropped == 20_000 - kept
        await link.send("still here")


async def test_no_proxy_is_asked(
    authority: trustme.CA,
    ca_file: str,
    unused_tcp_port: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("https_proxy", f"http://localhost:{unused_tcp_port}")
    monkeypatch.setenv("HTTPS_PROXY", f"http://localhost:{unused_tcp_port}")
    monkeypatch.delenv("no_proxy", raising=False)
    async with linked(authority, ca_file, stay) as (link, _):
        await link.send("direct")


async def test_what_is_sent_is_in_no_log(
    authority: trustme.CA, ca_file: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def echo(socket: ServerConnection) -> None:
        async for message in socket:
            await socket.send(message)

    caplog.set_level(logging.DEBUG)
    logging.getLogger("websockets.server").setLevel(logging.INFO)
    async with linked(authority, ca_file, echo) as (link, _):
        await link.send("planted")
        assert (await link.read()).text == "planted"
    assert "planted" not in caplog.text


async def test_a_link_that_was_never_opened_can_be_closed() -> None:
    link = WebSocketLink("wss://localhost:1")
    await link.close()
    with pytest.raises(TransportError):
        await link.send("x")
