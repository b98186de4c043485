"""The two commands, ``doctor --answer`` and ``doctor --with``, for both programs."""

from __future__ import annotations

import sys
import time
from typing import NamedTuple, TextIO

from biosensor_common.doctor.checks.interfaces import interfaces
from biosensor_common.doctor.children import ProbeError
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error
from biosensor_common.doctor.report import printable
from biosensor_common.doctor.runner import Report
from biosensor_common.doctor.two_sided import asking
from biosensor_common.doctor.two_sided.answering import PATIENCE_S, Answerer, Say
from biosensor_common.doctor.two_sided.facts import AGENT, NODE, End
from biosensor_common.doctor.two_sided.judgement import judge
from biosensor_common.doctor.two_sided.remedies import doctor_command, local_opening, port_option
from biosensor_common.doctor.two_sided.report import CHECK, as_json, as_text
from biosensor_common.doctor.two_sided.unreached import Attempt, judge_failure, port_way
from biosensor_common.errors import GatewayError
from biosensor_common.terminal import columns, wrapped


class Outcome(NamedTuple):
    """What came of a network check; *ends* are None if there was no conversation."""

    report: Report
    ends: tuple[End, End] | None


def check_with(context: Context, program: str, host: str, port: int, code: str) -> Outcome:
    """Ask another computer; whatever goes wrong is a finding.

    Parameters
    ----------
    context
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
        found = [judge_failure(problem, Attempt(context, program, host, port))]
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
    return WayHere(address, others, local_opening([port_way(context, port)]))


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
