"""Finds which of two computers blocks LSL between them: ``doctor --answer`` and ``--with``.

A user starts one of them as the answering side; the other one connects to it (`sides`). They
exchange lines of JSON over TCP after both have proved that they know a code, which the answering
side shows (`channel`). Each runs a `station`, which opens LSL's ports and one test stream, sends to
the other's ports, and searches for its streams. The results of both (`facts`) are evaluated
(`diagnosis`) and shown on both.
"""

from __future__ import annotations

import json
import socket
import sys
import time
from typing import NamedTuple, TextIO

from biosensor_common.doctor import firewall, report
from biosensor_common.doctor.check import AGENT, NODE, Category, Check, Context, Finding, error
from biosensor_common.doctor.firewall import TCP, Way, active_firewalls, opening_on
from biosensor_common.doctor.interfaces import adapters
from biosensor_common.doctor.lsl_checks import by_unicast
from biosensor_common.doctor.network_check import sides
from biosensor_common.doctor.network_check.diagnosis import doctor_command, judge, rows, sides_of
from biosensor_common.doctor.network_check.facts import End, as_message
from biosensor_common.doctor.network_check.sides import (
    ANSWER_PORT,
    PATIENCE_S,
    Answerer,
    Say,
    UnreachedError,
)
from biosensor_common.doctor.network_check.station import listed_streams, open_ports, sent_from_here
from biosensor_common.doctor.probe import ProbeError
from biosensor_common.doctor.report import Report, printable
from biosensor_common.errors import CredentialError, GatewayError, TransportReason
from biosensor_common.lsl import api_file
from biosensor_common.terminal import columns, wrapped

CHECK = Check(
    "network", Category.NETWORK, "the network to another computer, tested from both sides", __name__
)
_LOST = "The other computer's part of the result is unknown."
_LABEL, _COLUMN = 36, 21


class Outcome(NamedTuple):
    """Result of a network check; *ends* are None without a conversation."""

    report: Report
    ends: tuple[End, End] | None

    def as_text(self, encoding: str, width: int | None) -> str:
        """Return the result as text for a console of this encoding and width."""
        found = report.as_text(self.report, encoding, width)
        if self.ends is None:
            return found
        lines = [*sides_of(*self.ends), ""]
        for label, *cells in rows(*self.ends):
            row = f"{label:<{_LABEL}}" + "".join(f"{cell:<{_COLUMN}}" for cell in cells)
            lines.append(row.rstrip())
        table = "\n".join(lines).encode(encoding, "replace").decode(encoding)
        return f"{table}\n\n{found}"

    def as_json(self) -> str:
        """Return the result as JSON in ASCII; ``ends`` is null without a conversation."""
        ends = self.ends and dict(zip(("here", "there"), map(as_message, self.ends), strict=True))
        return json.dumps({**report.content(self.report), "ends": ends}, indent=2)


class _Attempt(NamedTuple):
    """The user's request: *program* connects to *host* at a TCP port."""

    context: Context
    program: str
    host: str
    port: int

    @property
    def again(self) -> str:
        """The command that repeats the request."""
        option = _port_option(self.port)
        return f"{doctor_command(self.program)} --with {self.host}{option} --code CODE"


def _judge_failure(problem: GatewayError | ProbeError, attempt: _Attempt) -> Finding:
    """Explain why there was no conversation; searches for the other's streams if that may help."""
    if isinstance(problem, ProbeError):
        return error(
            f"LSL cannot be used on this computer: {problem}",
            "Without it, nothing can be tested.",
            f"{doctor_command(attempt.program)} --only versions",
        )
    if isinstance(problem, UnreachedError):
        return _unreached(problem, attempt)
    if isinstance(problem, CredentialError):
        return error(
            str(problem), "Only a computer that knows the code gets an answer.", attempt.again
        )
    return error(
        str(problem),
        _LOST,
        f"on {attempt.host}, {_answer(attempt.port)}\nthen here: {attempt.again}",
    )


def _unreached(problem: UnreachedError, attempt: _Attempt) -> Finding:
    host, port = attempt.host, attempt.port
    if problem.reason is TransportReason.UNAVAILABLE:
        return error(
            str(problem),
            "Computer names do not work in every network; addresses do.",
            f"use the address that the other computer shows; there, {_answer(port)}",
        )
    if problem.reason is TransportReason.ABSENT:
        return error(
            str(problem),
            "It answers only when a person there has started it. Some firewalls also refuse.",
            f"on {host}, {_answer(port)}\nthen here: {attempt.again}\n"
            f"if it does answer there, {_opening(attempt)}",
        )
    return _silent(problem, attempt)


def _silent(problem: UnreachedError, attempt: _Attempt) -> Finding:
    """Distinguish a firewall from a computer that is off, by whether its streams answer."""
    host = attempt.host
    found = _streams_of(attempt)
    fix = f"{_opening(attempt)}\n{_turned_round(attempt)}"
    if found is None:
        return error(
            str(problem),
            f"The firewall of {host} drops incoming packets, or {host} is off or has another "
            "address. None of its streams answers either.",
            f"{fix}\ncheck the address: {_answer(attempt.port)} shows it there",
        )
    seen, received = found
    amount = "1 stream" if seen == 1 else f"{seen} streams"
    return error(
        f"{problem}, but {amount} of it answered, of which {received} can be received",
        f"So {host} is on and UDP passes; its firewall drops TCP {attempt.port}.",
        fix,
    )


def _streams_of(attempt: _Attempt) -> tuple[int, int] | None:
    """Return how many streams of a computer are found, and how many of them can be received."""
    try:
        address = socket.gethostbyname(attempt.host)
    except (OSError, UnicodeError):
        return None
    # Programs of this computer answer, too, and are not counted.
    listed = listed_streams(by_unicast(attempt.context.config, address))
    own = sent_from_here(listed)
    found = [each for each in listed if each not in own]
    if not found:
        return None
    opened = open_ports(address, (each.port for each in found if each.port))
    return len(found), sum(each.port in opened for each in found)


def _opening(attempt: _Attempt) -> str:
    """Return how the other computer's port is opened on any system."""
    ways = (_port_way(attempt.context, attempt.port),)
    return (
        f"on {attempt.host}, the command shown below the code there; with ufw, for instance: "
        f"{firewall.ufw(ways)}\nor with Windows, as administrator: {firewall.netsh(ways)}"
    )


def _port_way(context: Context, port: int) -> Way:
    """Return the ports to open for a port: all data ports of LSL, if it is one of them."""
    ports = api_file.ports(context.config)
    is_of_lsl = ports.first <= port <= ports.last
    return Way(TCP, ports.first, ports.last) if is_of_lsl else Way(TCP, port, port)


def _turned_round(attempt: _Attempt) -> str:
    option = _port_option(attempt.port)
    return (
        f"or the other way round, here: {doctor_command(attempt.program)} --answer{option}\n"
        f"and on {attempt.host} type what it shows"
    )


def _answer(port: int) -> str:
    option = _port_option(port)
    return (
        f"{doctor_command(AGENT)} --answer{option} "
        f"(where the node is: {doctor_command(NODE)} --answer{option})"
    )


def check_with(context: Context, program: str, host: str, port: int, code: str) -> Outcome:
    """Check the network to a computer, by name or IPv4 address; every failure becomes a finding."""
    begun = time.monotonic()
    try:
        ends = sides.ask(context, program, host, port, code)
    except (GatewayError, ProbeError) as problem:
        found = [_judge_failure(problem, _Attempt(context, program, host, port))]
        return _outcome(found, None, begun)
    return _outcome(judge(*ends), ends, begun)


def ask(context: Context, program: str, host: str, port: int, code: str, *, as_json: bool) -> int:
    """Check the network to a computer, print the result and return the exit code."""
    if not as_json:
        _say(f"Testing the network to {printable(host)} from both sides, about 15 s ...\n")
    return _print(check_with(context, program, host, port, code), as_json=as_json)


def answer(context: Context, program: str, port: int, *, as_json: bool) -> int:
    """Answer one computer, print the result and return the exit code."""
    # stdout is for the JSON only, so the code for the user goes to stderr.
    output = sys.stderr if as_json else sys.stdout
    begun = time.monotonic()
    try:
        with Answerer(context, program, port) as answerer:
            lines = _invitation(context, answerer)
            _say("\n".join(wrapped(each, columns(output), hang=4) for each in lines), output)
            outcome = answer_one(answerer, lambda sentence: _say(printable(sentence), output))
    except KeyboardInterrupt:
        _say("No computer has asked; this computer no longer answers.", output)
        return 1
    except GatewayError as problem:
        why = "Nothing was tried."
        fix = f"{doctor_command(program)} --answer{_port_option(port)}"
        return _print(_outcome([error(str(problem), why, fix)], None, begun), as_json=as_json)
    return _print(outcome, as_json=as_json)


def answer_one(answerer: Answerer, say: Say) -> Outcome:
    """Answer one computer and evaluate the results of both; see `Answerer.wait`."""
    begun = time.monotonic()
    ends = answerer.wait(say)
    return _outcome(judge(*ends), ends, begun)


class WayHere(NamedTuple):
    """How another computer reaches this one."""

    address: str
    """The address to try first."""
    others: tuple[str, ...]
    """Adapters with further addresses, as text."""
    opening: str
    """The command that opens the port here."""


def way_here(context: Context, port: int) -> WayHere:
    """Return the addresses at which other computers reach a TCP port of this one."""
    found = [each for each in adapters() if not each.is_loopback]
    real = [each for each in found if not each.is_virtual] or found
    address = real[0].addresses[0] if real else "127.0.0.1"
    others = tuple(str(each) for each in found if address not in each.addresses)
    return WayHere(
        address,
        others,
        opening_on(
            sys.platform, active_firewalls(), [_port_way(context, port)], firewall.NEIGHBOURS
        ),
    )


def _outcome(found: list[Finding], ends: tuple[End, End] | None, begun: float) -> Outcome:
    marked = tuple(CHECK.mark(each) for each in found)
    return Outcome(Report((CHECK,), marked, time.monotonic() - begun), ends)


def _print(outcome: Outcome, *, as_json: bool) -> int:
    text = outcome.as_text(sys.stdout.encoding or "ascii", columns(sys.stdout))
    _say(outcome.as_json() if as_json else text)
    return 0 if outcome.report.is_good else 1


def _invitation(context: Context, answerer: Answerer) -> list[str]:
    way = way_here(context, answerer.port)
    typed = f"--with {way.address}{_port_option(answerer.port)} --code {answerer.code}"
    more = [f"Its other addresses: {', '.join(way.others)}."] if way.others else []
    return [
        f"This computer answers for {PATIENCE_S / 60:g} minutes (Ctrl-C ends it).",
        "On the other one, type:",
        f"  {doctor_command(AGENT)} {typed}",
        "or, where the node is:",
        f"  {doctor_command(NODE)} {typed}",
        "",
        *more,
        "If the other computer reports that nothing comes back, open the port here:",
        *(f"  {line}" for line in way.opening.splitlines()),
        "",
    ]


def _say(text: str, output: TextIO | None = None) -> None:
    place = sys.stdout if output is None else output
    encoding = place.encoding or "ascii"
    place.write(text.encode(encoding, "replace").decode(encoding) + "\n")
    place.flush()


def _port_option(port: int) -> str:
    """Return the option for a port, with a leading blank; empty for the default port."""
    return "" if port == ANSWER_PORT else f" --port {port}"
