"""The conversation of two computers: its code, its limits, and both sides on this one."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager

import pytest

from biosensor_common.doctor.check import AGENT, NODE, Context, Level
from biosensor_common.doctor.network_check import channel as channels
from biosensor_common.doctor.network_check import sides
from biosensor_common.doctor.network_check.channel import (
    MAX_GREETING,
    MAX_LINE,
    Channel,
    new_code,
    read_code,
)
from biosensor_common.doctor.network_check.command import check_with
from biosensor_common.doctor.network_check.diagnosis import judge
from biosensor_common.doctor.network_check.facts import End, as_message, read
from biosensor_common.doctor.network_check.sides import MAX_TRIES, Answerer
from biosensor_common.errors import (
    CredentialError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.doctor.context import GUIDE
from tests.doctor.outlets import Offered

LOCAL, OTHER = "127.0.0.1", "127.0.0.2"
WAIT_S = 30.0
Ends = tuple[End, End]


def wrong(code: str) -> str:
    return f"{(int(code) + 1) % 1_000_000:06d}"


@contextmanager
def answering(patience_s: float = 60.0) -> Generator[tuple[Answerer, Future[Ends], list[str]]]:
    """The side that answers, with what it says; its outcome is for the test to fetch."""
    said: list[str] = []
    with (
        ThreadPoolExecutor(1) as pool,
        Answerer(Context(guide=GUIDE), NODE, 0, address=OTHER, patience_s=patience_s) as answerer,
    ):
        yield answerer, pool.submit(answerer.wait, said.append), said


@contextmanager
def connected() -> Generator[tuple[Channel, socket.socket]]:
    """A channel, and the bare socket at its other end."""
    one, other = socket.socketpair()
    with closing(one), closing(other):
        yield Channel(one, "robot"), other


@pytest.fixture
def handshaken() -> Generator[Callable[[str, str], tuple[Channel, Channel]]]:
    """Two channels whose ends have the same code or another."""
    with ExitStack() as stack, ThreadPoolExecutor(1) as pool:

        def greet(one: str, other: str) -> tuple[Channel, Channel]:
            here, there = (stack.enter_context(closing(each)) for each in socket.socketpair())
            asked, answered = Channel(here, "robot"), Channel(there, "lab-pc")
            answer = pool.submit(channels.greet_as_answering, answered, other)
            channels.greet_as_asking(asked, one)
            answer.result(WAIT_S)
            return asked, answered

        yield greet


def test_a_code_is_six_digits_however_it_is_typed() -> None:
    codes = {new_code() for _ in range(50)}
    assert len(codes) > 40
    assert {read_code(code) for code in codes} == codes
    assert read_code(" 012-345 ") == "012345"
    for text in ("", "12345", "1234567", "12345a", "١٢٣٤٥٦"):
        with pytest.raises(CredentialError):
            read_code(text)


@pytest.mark.nightly
def test_what_is_not_sealed_by_the_other_one_is_not_taken() -> None:
    key, words = b"k" * 32, {"do": "send"}
    one, other = socket.socketpair()
    with closing(one), closing(other):
        asked, answered = Channel(one, "robot"), Channel(other, "lab-pc")
        asked.secure(key, b"asking", b"answering")
        answered.secure(key, b"answering", b"asking")
        asked.send(words)
        assert answered.receive(WAIT_S) == words
        # The same line once more, as somebody in between could send it.
        asked._sent = 0  # pyright: ignore[reportPrivateUsage]
        asked.send(words)
        with pytest.raises(ProtocolError):
            answered.receive(WAIT_S)
        # One of its own, sent back.
        answered.send(words)
        one.sendall(one.recv(1000))
        with pytest.raises(ProtocolError):
            answered.receive(WAIT_S)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "line",
    [b"[1]\n", b"no json\n", b"\xff\xfe\n", b"[" * 1000 + b"\n", b"x" * (MAX_GREETING + 1) + b"\n"],
    ids=["list", "text", "bytes", "deep", "long"],
)
def test_a_stranger_is_held_to_small_lines_of_json(line: bytes) -> None:
    with connected() as (channel, other):
        other.sendall(line)
        with pytest.raises(ProtocolError) as refused:
            channel.receive(WAIT_S)
    assert refused.value.reason is ProtocolReason.GARBAGE


@pytest.mark.nightly
def test_a_line_without_end_is_not_kept() -> None:
    with connected() as (channel, other):
        channel.secure(b"k" * 32, b"asking", b"answering")

        def flood() -> None:
            try:
                for _ in range(4 * MAX_LINE // 1000):
                    other.sendall(b"x" * 1000)
            except OSError:
                pass

        flooding = threading.Thread(target=flood)
        flooding.start()
        with pytest.raises(ProtocolError):
            channel.receive(WAIT_S)
        kept = channel._rest  # pyright: ignore[reportPrivateUsage]
        assert len(kept) < MAX_LINE + 100_000
        channel.connection.close()
        flooding.join(WAIT_S)


@pytest.mark.nightly
def test_who_is_silent_or_slow_or_gone_is_not_waited_for() -> None:
    with connected() as (channel, other):
        ended = threading.Event()

        def drip() -> None:
            while not ended.wait(0.02):
                other.sendall(b"x")

        dripping = threading.Thread(target=drip)
        dripping.start()
        with pytest.raises(TransportError) as slow:
            channel.receive(0.3)
        ended.set()
        dripping.join()
        other.close()
        with pytest.raises(TransportError) as gone:
            channel.receive(WAIT_S)
    assert (slow.value.reason, gone.value.reason) == (TransportReason.SILENT, TransportReason.LOST)


@pytest.mark.nightly
def test_both_sides_have_to_know_the_code(
    handshaken: Callable[[str, str], tuple[Channel, Channel]],
) -> None:
    asked, answered = handshaken("012345", "012345")
    asked.send({"do": "open"})
    assert answered.receive(WAIT_S) == {"do": "open"}
    with pytest.raises(CredentialError):
        handshaken("012345", "012346")


@pytest.mark.nightly
def test_who_only_claims_to_know_the_code_is_not_told_anything() -> None:
    """The one who asks goes on only with somebody who has proved it, too."""
    with connected() as (channel, other), ThreadPoolExecutor(1) as pool:
        asked = pool.submit(channels.greet_as_asking, channel, "012345")
        stranger = Channel(other, "stranger")
        stranger.receive(WAIT_S)
        greeting = {"speak": channels.LANGUAGE, "version": channels.VERSION, "nonce": "0" * 32}
        stranger.send(greeting)
        stranger.receive(WAIT_S)
        stranger.send({"proof": "0" * 64})
        assert isinstance(asked.exception(WAIT_S), CredentialError)


@pytest.mark.nightly
def test_another_version_is_told_from_another_program() -> None:
    for greeting, reason, part in (
        ({"speak": channels.LANGUAGE, "version": 2}, ProtocolReason.UNSUPPORTED, "version 2 of"),
        ({"speak": channels.LANGUAGE, "version": 1}, ProtocolReason.GARBAGE, "nonce"),
        ({"hello": "world"}, ProtocolReason.GARBAGE, "another program"),
    ):
        with connected() as (channel, other):
            other.sendall(json.dumps(greeting).encode() + b"\n")
            with pytest.raises(ProtocolError) as refused:
                channels.greet_as_answering(channel, "012345")
            # Who speaks another version gets to know ours.
            assert json.loads(other.recv(1000))["version"] == channels.VERSION
        assert refused.value.reason is reason
        assert part in str(refused.value)


@pytest.mark.nightly
def test_guessing_ends_soon(session: str) -> None:
    del session
    with answering() as (answerer, outcome, said):
        for _ in range(MAX_TRIES):
            outcome_of_guess = check_with(
                Context(guide=GUIDE), AGENT, OTHER, answerer.port, wrong(answerer.code)
            )
            (finding,) = outcome_of_guess.report.findings
            assert finding.what.startswith(f"{OTHER} shows another code")
        assert isinstance(outcome.exception(WAIT_S), CredentialError)
    assert said == [f"{LOCAL} does not know the code, and was refused"] * MAX_TRIES
    with pytest.raises(sides.UnreachedError):
        sides.ask(Context(guide=GUIDE), AGENT, OTHER, answerer.port, answerer.code)


@pytest.mark.nightly
def test_nobody_is_waited_for_for_ever(session: str, monkeypatch: pytest.MonkeyPatch) -> None:
    del session
    monkeypatch.setattr(channels, "GREETING_S", 0.2)
    with (
        answering(patience_s=1.0) as (answerer, outcome, said),
        # Somebody who connects and says nothing does not stop it.
        socket.create_connection((OTHER, answerer.port)),
    ):
        error = outcome.exception(WAIT_S)
    assert isinstance(error, TransportError)
    assert error.reason is TransportReason.SILENT
    assert said == [f"{LOCAL} said nothing for 0.2 s; start both sides again"]


WRONG: list[tuple[tuple[str, ...], object]] = [
    (("computer", "name"), "x" * 1000),
    (("computer", "address"), "localhost\nx"),
    (("computer", "ports", "first"), 80),
    (("arrivals", "udp"), {"port": True}),
    (("arrivals", "tcp"), {str(port): True for port in range(20000, 20100)}),
    (("look", "offset_s"), float("inf")),
    (("look", "received"), 1),
    (("seen",), [{}] * 1000),
    (("own",), [{"name": 5}]),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("path", "value"), WRONG)
def test_what_the_other_one_claims_is_read_with_care(
    outcome: Ends, path: tuple[str, ...], value: object
) -> None:
    message = json.loads(json.dumps(as_message(outcome[1])))
    assert read(End, message) == outcome[1]
    inner = message
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    with pytest.raises(ProtocolError):
        read(End, message)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Generator[Ends]:
    """What the one who asks gets to know, and that the other one knows the same."""
    config = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    config.write_text(
        f"[lab]\nSessionID = both-{time.time_ns()}\n[multicast]\nResolveScope = machine\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LSLAPICFG", str(config))
        with answering() as (answerer, outcome, said):
            typed = f"{answerer.code[:3]} {answerer.code[3:]}"
            here, there = sides.ask(Context(guide=GUIDE), AGENT, OTHER, answerer.port, typed)
            assert outcome.result(WAIT_S) == (there, here)
            assert said == []
        yield here, there


@pytest.mark.nightly
def test_both_sides_on_this_computer(outcome: Ends) -> None:
    here, there = outcome
    assert (here.computer.program, there.computer.program) == (AGENT, NODE)
    assert (here.computer.other, there.computer.other) == (OTHER, LOCAL)
    for end in outcome:
        assert end.arrivals.discovery is True
        assert list(end.arrivals.udp.values()) == list(end.arrivals.tcp.values()) == [True, True]
        assert end.look.directly
        assert end.look.received
        assert abs(end.look.offset_s or 1.0) < 0.1
        # The tests keep LSL on this computer.
        assert end.computer.keeps_to_itself
        assert end.look.by_multicast is None
    levels = {each.level for each in judge(here, there)}
    assert levels == {Level.OK, Level.NOTE}


@pytest.mark.nightly
def test_the_streams_of_this_computer_are_its_own(session: str, offer: Callable[..., None]) -> None:
    offer(Offered("ecg", "ecg-1"))
    with answering() as (answerer, _, _):
        here, there = sides.ask(Context(guide=GUIDE), AGENT, OTHER, answerer.port, answerer.code)
    (own,) = here.own
    assert (own.name, own.uid in there.reached) == ("ecg", True)
    assert any("sees and opens 1 stream of" in each.what for each in judge(here, there))
