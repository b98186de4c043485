"""The two commands, ``doctor --answer`` and ``doctor --with``, for both programs."""

from __future__ import annotations

import socket
import sys
import time
from typing import NamedTuple, TextIO

from biosensor_common.doctor import firewall as firewall_rules
from biosensor_common.doctor.check import Context, Finding, error
from biosensor_common.doctor.firewall import TCP, Way
from biosensor_common.doctor.network import adapters as interfaces
from biosensor_common.doctor.probe import ProbeError
from biosensor_common.doctor.report import Report, printable
from biosensor_common.doctor.streams import by_unicast
from biosensor_common.doctor.two_sided import asking
from biosensor_common.doctor.two_sided.answering import PATIENCE_S, Answerer, Say
from biosensor_common.doctor.two_sided.asking import UnreachedError
from biosensor_common.doctor.two_sided.facts import AGENT, NODE, End
from biosensor_common.doctor.two_sided.judgement import judge
from biosensor_common.doctor.two_sided.remedies import doctor_command, local_opening, port_option
from biosensor_common.doctor.two_sided.report import CHECK, as_json, as_text
from biosensor_common.doctor.two_sided.sending import open_ports
from biosensor_common.doctor.two_sided.station import listed_streams, sent_from_here
from biosensor_common.errors import CredentialError, GatewayError, TransportReason
from biosensor_common.lsl import api_file as lsl_text
from biosensor_common.terminal import columns, wrapped

_LOST = "What the other computer would have said is unknown."


class Attempt(NamedTuple):
    """What a person asked for: *program* asks the computer *host* at a TCP port."""

    context: Context
    program: str
    host: str
    port: int

    @property
    def again(self) -> str:
        """The command that asks once more."""
        option = port_option(self.port)
        return f"{doctor_command(self.program)} --with {self.host}{option} --code CODE"


def _judge_failure(problem: GatewayError | ProbeError, attempt: Attempt) -> Finding:
    """Say why there was no conversation; looks for streams of the other one if that may help."""
    if isinstance(problem, ProbeError):
        return error(
            f"LSL cannot be used on this computer: {problem}",
            "Without it nothing can be tried.",
            f"{doctor_command(attempt.program)} --only versions",
        )
    if isinstance(problem, UnreachedError):
        return _unreached(problem, attempt)
    if isinstance(problem, CredentialError):
        return error(str(problem), "Only who knows the code is answered.", attempt.again)
    return error(
        str(problem),
        _LOST,
        f"on {attempt.host}, {_answer(attempt.port)}\nthen here: {attempt.again}",
    )


def _unreached(problem: UnreachedError, attempt: Attempt) -> Finding:
    host, port = attempt.host, attempt.port
    if problem.reason is TransportReason.UNAVAILABLE:
        return error(
            str(problem),
            "Names of computers are not known in every network, addresses are.",
            f"use the address that the other computer shows; there, {_answer(port)}",
        )
    if problem.reason is TransportReason.ABSENT:
        return error(
            str(problem),
            "It answers only while a person there has asked for it. Some firewalls refuse, too.",
            f"on {host}, {_answer(port)}\nthen here: {attempt.again}\n"
            f"if it does answer there, {_opening(attempt)}",
        )
    return _silent(problem, attempt)


def _silent(problem: UnreachedError, attempt: Attempt) -> Finding:
    """Tell a firewall from a computer that is off, as far as its streams betray it."""
    host = attempt.host
    found = _streams_of(attempt)
    fix = f"{_opening(attempt)}\n{_turned_round(attempt)}"
    if found is None:
        return error(
            str(problem),
            f"The firewall of {host} drops what comes in, or {host} is off or has another "
            "address. None of its streams answers either.",
            f"{fix}\nmake sure of the address: {_answer(attempt.port)} shows it there",
        )
    seen, received = found
    amount = "1 stream" if seen == 1 else f"{seen} streams"
    return error(
        f"{problem}, but {amount} of it answered, of which {received} can be received",
        f"So {host} is on and UDP passes; its firewall drops TCP {attempt.port}.",
        fix,
    )


def _streams_of(attempt: Attempt) -> tuple[int, int] | None:
    """Return how many streams of a computer are seen, and how many of them can be received."""
    try:
        address = socket.gethostbyname(attempt.host)
    except (OSError, UnicodeError):
        return None
    # Programs of this computer answer besides whoever is asked.
    listed = listed_streams(by_unicast(attempt.context.config, address))
    own = sent_from_here(listed)
    found = [each for each in listed if each not in own]
    if not found:
        return None
    opened = open_ports(address, (each.port for each in found if each.port))
    return len(found), sum(each.port in opened for each in found)


def _opening(attempt: Attempt) -> str:
    """Say how the other one is opened, whatever its system is."""
    ways = (_port_way(attempt.context, attempt.port),)
    return (
        f"on {attempt.host}, the command that stands below the code there; with ufw, for "
        f"instance: {firewall_rules.ufw(ways)}\n"
        f"or with Windows, as administrator: {firewall_rules.netsh(ways)}"
    )


def _port_way(context: Context, port: int) -> Way:
    """Return what is to be open so that a port is: all data ports of LSL, if it is one."""
    ports = lsl_text.ports(context.config)
    is_of_lsl = ports.first <= port <= ports.last
    return Way(TCP, ports.first, ports.last) if is_of_lsl else Way(TCP, port, port)


def _turned_round(attempt: Attempt) -> str:
    option = port_option(attempt.port)
    return (
        f"or the other way round, here: {doctor_command(attempt.program)} --answer{option}\n"
        f"and on {attempt.host} type what it shows"
    )


def _answer(port: int) -> str:
    option = port_option(port)
    return (
        f"{doctor_command(AGENT)} --answer{option} "
        f"(where the node is: {doctor_command(NODE)} --answer{option})"
    )


class Outcome(NamedTuple):
    """What came of a network check; *ends* are None if there was no conversation."""

    report: Report
    ends: tuple[End, End] | None


def check_with(context: Context, program: str, host: str, port: int, code: str) -> Outcome:
    """Ask another computer; whatever goes wrong is a finding.

    Parameters
    ----------
    program
        ``agent`` or ``node``.
    host
        Name or IPv4 address of the other computer.
    port
        TCP port at which it answers.
    code
        What it shows.
    """
    begun = time.monotonic()
    try:
        ends = asking.ask(context, program, host, port, code)
    except (GatewayError, ProbeError) as problem:
        found = [_judge_failure(problem, Attempt(context, program, host, port))]
        return _outcome(found, None, begun)
    return _outcome(judge(*ends), ends, begun)


def ask(context: Context, program: str, host: str, port: int, code: str, *, json: bool) -> int:
    """Ask another computer and print what came of it; return the exit code."""
    if not json:
        _say(f"Trying the network to {printable(host)} from both sides, about 15 s ...\n")
    return _print(check_with(context, program, host, port, code), json=json)


def answer(context: Context, program: str, port: int, *, json: bool) -> int:
    """Answer one computer, print what came of it, and return the exit code."""
    # A script wants nothing but JSON on stdout, and a person the code all the same.
    output = sys.stderr if json else sys.stdout
    begun = time.monotonic()
    try:
        with Answerer(context, program, port) as answerer:
            lines = _invitation(context, answerer)
            _say("\n".join(wrapped(each, columns(output), hang=4) for each in lines), output)
            outcome = answer_one(answerer, lambda sentence: _say(printable(sentence), output))
    except KeyboardInterrupt:
        _say("Nobody has asked; this computer does not answer any more.", output)
        return 1
    except GatewayError as problem:
        why = "Nothing was tried."
        fix = f"{doctor_command(program)} --answer{port_option(port)}"
        return _print(_outcome([error(str(problem), why, fix)], None, begun), json=json)
    return _print(outcome, json=json)


def answer_one(answerer: Answerer, say: Say) -> Outcome:
    """Answer one computer, and judge what both have found out; see `Answerer.wait`."""
    begun = time.monotonic()
    ends = answerer.wait(say)
    return _outcome(judge(*ends), ends, begun)


class WayHere(NamedTuple):
    """How another computer reaches this one.

    Attributes
    ----------
    address
        The one to try first.
    others
        Adapters with further ones, in words.
    opening
        The command that opens the port here.
    """

    address: str
    others: tuple[str, ...]
    opening: str


def way_here(context: Context, port: int) -> WayHere:
    """Tell by which way another computer reaches a TCP port of this one."""
    adapters = [each for each in interfaces() if not each.is_loopback]
    real = [each for each in adapters if not each.is_virtual] or adapters
    address = real[0].addresses[0] if real else "127.0.0.1"
    others = tuple(str(each) for each in adapters if address not in each.addresses)
    return WayHere(address, others, local_opening([_port_way(context, port)]))


def _outcome(found: list[Finding], ends: tuple[End, End] | None, begun: float) -> Outcome:
    marked = tuple(CHECK.mark(each) for each in found)
    return Outcome(Report((CHECK,), marked, time.monotonic() - begun), ends)


def _print(outcome: Outcome, *, json: bool) -> int:
    if json:
        _say(as_json(*outcome))
    else:
        _say(as_text(*outcome, sys.stdout.encoding or "ascii", columns(sys.stdout)))
    return 0 if outcome.report.is_good else 1


def _invitation(context: Context, answerer: Answerer) -> list[str]:
    way = way_here(context, answerer.port)
    typed = f"--with {way.address}{port_option(answerer.port)} --code {answerer.code}"
    more = [f"Its other addresses: {', '.join(way.others)}."] if way.others else []
    return [
        f"For {PATIENCE_S / 60:g} minutes this computer answers (Ctrl-C ends it).",
        "On the other one, type:",
        f"  {doctor_command(AGENT)} {typed}",
        "or, where the node is:",
        f"  {doctor_command(NODE)} {typed}",
        "",
        *more,
        "If it is said there that nothing comes back, open the port here:",
        *(f"  {line}" for line in way.opening.splitlines()),
        "",
    ]


def _say(text: str, output: TextIO | None = None) -> None:
    place = sys.stdout if output is None else output
    encoding = place.encoding or "ascii"
    place.write(text.encode(encoding, "replace").decode(encoding) + "\n")
    place.flush()
