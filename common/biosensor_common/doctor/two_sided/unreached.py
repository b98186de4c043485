"""Explains why the other computer did not converse, and what to do."""

from __future__ import annotations

import socket
from typing import NamedTuple

from biosensor_common.doctor import firewall_rules, lsl_text
from biosensor_common.doctor.checks.discovery import by_unicast
from biosensor_common.doctor.children import ProbeError
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error
from biosensor_common.doctor.firewall_rules import TCP, Way
from biosensor_common.doctor.two_sided.asking import UnreachedError
from biosensor_common.doctor.two_sided.facts import AGENT, NODE
from biosensor_common.doctor.two_sided.remedies import doctor_command, port_option
from biosensor_common.doctor.two_sided.sending import open_ports
from biosensor_common.doctor.two_sided.station import listed_streams, sent_from_here
from biosensor_common.errors import CredentialError, GatewayError, TransportReason

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


def judge_failure(problem: GatewayError | ProbeError, attempt: Attempt) -> Finding:
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
    ways = (port_way(attempt.context, attempt.port),)
    return (
        f"on {attempt.host}, the command that stands below the code there; with ufw, for "
        f"instance: {firewall_rules.ufw(ways)}\n"
        f"or with Windows, as administrator: {firewall_rules.netsh(ways)}"
    )


def port_way(context: Context, port: int) -> Way:
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
