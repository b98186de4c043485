"""The conversation of two computers, and what is said of what came of it."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import AGENT, NODE, Context, Finding, Level
from biosensor_common.doctor.network_check import CHECK, check_with, sides
from biosensor_common.doctor.network_check import Outcome as Checked
from biosensor_common.doctor.network_check import channel as channels
from biosensor_common.doctor.network_check.channel import (
    MAX_GREETING,
    MAX_LINE,
    Channel,
    new_code,
    read_code,
)
from biosensor_common.doctor.network_check.diagnosis import judge, rows
from biosensor_common.doctor.network_check.facts import (
    Arrivals,
    Computer,
    End,
    Look,
    Stream,
    as_message,
    read,
)
from biosensor_common.doctor.network_check.sides import MAX_TRIES, Answerer
from biosensor_common.doctor.report import Report
from biosensor_common.errors import (
    CredentialError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.lsl.api_file import Ports
from biosensor_gateway.doctor.context import GUIDE
from tests.doctor.conftest import only
from tests.doctor.outlets import Offered

if TYPE_CHECKING:
    from tests.doctor.conftest import Outcome

# The conversation of two computers: its code, its limits, and both sides on this one.

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
    assert said == [f"{LOCAL} does not know the code and was refused"] * MAX_TRIES
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
    assert said == [f"{LOCAL} sent nothing for 0.2 s; start both sides again"]


WRONG: list[tuple[tuple[str, ...], object]] = [
    (("computer", "name"), "x" * 1000),
    (("computer", "address"), "localhost\nx"),
    (("computer", "ports", "first"), 80),
    (("arrivals", "udp"), {"port": True}),
    (("arrivals", "tcp"), {str(port): True for port in range(20000, 20100)}),
    (("look", "offset_s"), float("inf")),
    (("look", "offset_s"), 10**400),
    (("look", "received"), 1),
    (("seen",), [{}] * 1000),
    (("own",), [{"name": 5}]),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("path", "value"), WRONG, ids=range(len(WRONG)))
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


# What is said of two computers, for systems and networks that are not here.
PORTS = Ports(16571, 16572, 16827)
ALL = {16572: True, 16827: True}
NONE = {16572: False, 16827: False}
PART = {16572: True, 16827: False}
SEEN = Look(True, True, "", True, 0.001, 0.002)
UNSEEN = Look(False, False)


def computer(name: str, **changed: object) -> Computer:
    own, other = ("10.0.0.1", "10.0.0.2") if name == "lab-pc" else ("10.0.0.2", "10.0.0.1")
    plain = Computer(
        name=name,
        system="linux",
        program=AGENT if name == "lab-pc" else NODE,
        address=own,
        other=other,
        is_near=True,
        session="default",
        ports=PORTS,
    )
    return replace(plain, **changed)  # type: ignore[arg-type]


def arrivals(**changed: object) -> Arrivals:
    return replace(Arrivals(("10.0.0.9",), True, ALL, ALL), **changed)  # type: ignore[arg-type]


@pytest.fixture
def pc() -> End:
    return End(computer("lab-pc"), arrivals(), SEEN)


@pytest.fixture
def robot() -> End:
    return End(computer("robot"), arrivals(), SEEN)


def bad(findings: list[Finding]) -> list[Finding]:
    return [each for each in findings if each.level in {Level.ERROR, Level.WARNING}]


def test_what_one_side_found_reaches_the_other_whole(pc: End, robot: End) -> None:
    for end in (pc, robot):
        assert read(End, json.loads(json.dumps(as_message(end)))) == end


def test_windows_gets_its_own_command_and_the_answer_goes_to_the_right_side(
    pc: End, robot: End
) -> None:
    closed = replace(pc, computer=replace(pc.computer, system="win32"), arrivals=arrivals(tcp=NONE))
    deaf = replace(robot, look=replace(SEEN, received=False))
    (finding,) = bad(judge(closed, deaf))
    command = "dir=in action=allow protocol=TCP localport=16572-16827 remoteip=LocalSubnet"
    assert finding.fix.startswith("here, as administrator: netsh advfirewall firewall add rule")
    assert command in finding.fix
    # From the robot's side it is the other computer that has to be opened.
    (mirrored,) = bad(judge(deaf, closed))
    assert mirrored.what == "lab-pc blocks TCP 16572 to 16827 from this computer"
    assert mirrored.fix.startswith("on lab-pc, as administrator: netsh")
    # Through a VPN, who is to be let in is no neighbour.
    far = replace(closed, computer=replace(closed.computer, is_near=False))
    assert "remoteip=10.0.0.2 " in bad(judge(far, deaf))[0].fix


def test_only_the_firewall_that_is_on_is_named(pc: End, robot: End) -> None:
    shut = replace(
        robot,
        computer=replace(robot.computer, firewalls=("ufw", "nftables")),
        arrivals=arrivals(discovery=False, multicast=(), udp=NONE),
    )
    (finding,) = bad(judge(replace(pc, look=UNSEEN), replace(shut, look=UNSEEN)))
    assert finding.what == "robot blocks UDP 16571, 16572 to 16827 from this computer"
    assert finding.fix == (
        "on robot, with ufw: sudo ufw allow 16571/udp && sudo ufw allow 16572:16827/udp"
    )


def test_a_part_of_the_ports_is_told_from_all(pc: End, robot: End) -> None:
    (finding,) = bad(judge(pc, replace(robot, arrivals=arrivals(tcp=PART))))
    assert finding.level is Level.ERROR
    assert finding.why.startswith("TCP 16572 comes in and 16827 does not.")


def test_a_firewall_that_lets_in_answers_only_is_no_error(pc: End, robot: End) -> None:
    (finding,) = bad(judge(pc, replace(robot, arrivals=arrivals(udp=NONE))))
    assert finding.level is Level.WARNING
    assert "UDP 16572 to 16827" in finding.what


def test_known_peers_make_up_for_multicast(pc: End, robot: End) -> None:
    dark = replace(robot, arrivals=arrivals(multicast=()))
    asking = replace(pc, look=replace(SEEN, by_multicast=False))
    cause = only(judge(asking, dark), "multicast from this computer does not reach robot")
    assert cause.level is Level.ERROR
    assert "here: biosensor-gateway config lsl --for two-pc --peer 10.0.0.2\n" in cause.fix
    told = replace(asking, computer=replace(asking.computer, asks_the_other=True))
    assert only(judge(told, dark), "multicast from").level is Level.NOTE


def test_what_no_port_explains_is_said_as_such(pc: End, robot: End) -> None:
    (finding,) = bad(judge(replace(pc, look=UNSEEN), robot))
    assert finding.what.startswith("robot -> this computer: a test stream is not found at all")
    assert "python3 -m lsl_to_ros.doctor" in finding.fix


@pytest.mark.parametrize(
    ("changed", "part"),
    [
        ({"session": "p01"}, "the LSL session is default on this computer and p01 on robot"),
        ({"ports": Ports(16571, 17000, 17255)}, "LSL's port of the first stream is 16572"),
        ({"ports": Ports(16600, 16572, 16827)}, "LSL's port of discovery is 16571"),
        ({"keeps_to_itself": True}, "LSL on robot is restricted to its own computer"),
        (
            {"address": "172.17.0.2"},
            "this computer reaches robot on 10.0.0.2, but its own address is 172.",
        ),
    ],
)
def test_what_is_set_up_differently(
    pc: End, robot: End, changed: dict[str, object], part: str
) -> None:
    other = replace(robot, computer=replace(robot.computer, **changed))  # type: ignore[arg-type]
    assert only(bad(judge(pc, other)), part)


def test_two_networks_and_a_slow_one_are_noticed(pc: End, robot: End) -> None:
    by_wifi = replace(pc, look=replace(SEEN, address="192.168.1.7", round_trip_s=0.3))
    found = judge(by_wifi, robot)
    note = only(found, "finds the streams of robot on 192.168.1.7, not on 10.0.0.2")
    assert note.level is Level.NOTE
    assert only(bad(found), "the clock's offset is known to 150 ms only")


def test_each_stream_that_is_not_seen_or_not_received_is_named(pc: End, robot: End) -> None:
    ecg, eda = (Stream(name, name, f"uid-{name}", "robot", 16572) for name in ("ecg", "eda"))
    sending = replace(robot, own=(ecg, eda))
    found = judge(replace(pc, seen=(ecg,)), sending)
    assert only(found, "does not see 1 of 2 streams of robot: eda").level is Level.ERROR
    assert only(found, "sees, but cannot receive from robot: ecg").level is Level.ERROR
    all_well = judge(replace(pc, seen=(ecg, eda), reached=("uid-ecg", "uid-eda")), sending)
    assert not bad(all_well)


def test_a_name_from_elsewhere_steers_no_terminal_and_no_line_is_too_long(
    pc: End, robot: End
) -> None:
    names = "\x1b[2Jrobot", "a-computer-with-a-name-as-long-as-windows-lets-it-be", "lab-pc"
    for name in names:
        other = replace(
            robot,
            computer=replace(robot.computer, name=name, system="win32"),
            arrivals=arrivals(udp=PART, tcp=NONE, multicast=()),
        )
        marked = tuple(CHECK.mark(each) for each in judge(pc, other))
        text = Checked(Report((CHECK,), marked, 1.0), (pc, other)).as_text("ascii", 80)
        assert "\x1b" not in text
        assert max(map(len, text.splitlines())) <= 80, text
        assert "UDP 16572 to 16827" in text


def test_the_table_has_a_column_for_each_direction(pc: End, robot: End) -> None:
    ecg = Stream("ecg", "ecg", "uid-ecg", "robot", 16572)
    here = replace(pc, arrivals=arrivals(multicast=(), udp=PART), look=UNSEEN, seen=(ecg,))
    heading, *table = rows(here, replace(robot, own=(ecg,), arrivals=arrivals(tcp={})))
    assert heading == ("", "robot -> here", "here -> robot")
    assert table == [
        ("multicast, UDP 16571", "NO", "yes"),
        ("UDP 16571", "yes", "yes"),
        ("UDP 16572 to 16827", "PART", "yes"),
        ("TCP 16572 to 16827", "yes", "-"),
        ("test stream found by multicast", "NO", "yes"),
        ("  found when asked for directly", "NO", "yes"),
        ("  received", "NO", "yes"),
        ("  round trip", "NO", "2.0 ms"),
        ("streams seen", "1 of 1", "-"),
        ("  whose port opens", "0 of 1", "-"),
    ]


def test_the_options_that_exclude_each_other(run: Callable[..., Outcome]) -> None:
    for arguments in (("--answer", "--with", "robot"), ("--answer", "--only", "ports")):
        outcome = run(*arguments)
        assert outcome.code == 2
        assert "exclude each other" in " ".join(outcome.out.split())


@pytest.mark.nightly
def test_a_code_that_cannot_be_one_and_a_computer_that_is_unknown(
    run: Callable[..., Outcome],
) -> None:
    typed = run("--with", "127.0.0.1", "--code", "12", "--json")
    assert typed.code == 1
    assert "'12' is not a code" in typed.json["findings"][0]["what"]
    unknown = run("--with", "no-such-host.invalid", "--code", "123456", "--json")
    assert unknown.json["findings"][0]["what"] == "no-such-host.invalid has no IPv4 address"
    assert unknown.json["ends"] is None
