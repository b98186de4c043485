"""Judges whether LSL is set up on both computers so that they can find each other."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import ip_address

from biosensor_common.doctor.finding import Finding, error, note, warning
from biosensor_common.doctor.two_sided.remedies import Party


def judge_setting(one: Party, other: Party) -> Iterator[Finding]:
    """Compare sessions, ports, scopes and addresses."""
    if one.computer.session != other.computer.session:
        yield error(
            f"the LSL session is {one.computer.session} on {one.name} and "
            f"{other.computer.session} on {other.name}",
            "LSL programs see only streams of their own session.",
            "have the same on both: SessionID below [lab] in lsl_api.cfg, or session_id of the "
            "agent's settings and of the node's parameters",
        )
    yield from _ports(one, other)
    for party in (one, other):
        yield from _scope(party)
    yield from _translation(one, other)


def _ports(one: Party, other: Party) -> Iterator[Finding]:
    for what, key, left, right in (
        ("discovery", "MulticastPort", one.computer.ports[0], other.computer.ports[0]),
        ("the first stream", "BasePort", one.computer.ports[1], other.computer.ports[1]),
    ):
        if left != right:
            yield error(
                f"LSL's port of {what} is {left} on {one.name} and {right} on {other.name}",
                "LSL programs ask at their own number, where nobody answers.",
                f"have the same {key} below [ports] in lsl_api.cfg on both, or none",
            )


def _scope(party: Party) -> Iterator[Finding]:
    if not party.computer.keeps_to_itself:
        return
    what = f"LSL on {party.name} keeps to its own computer (ResolveScope is machine)"
    why = "It looks for streams there only, and is found there only; multicast was not tried."
    fix = f"{party.on}: remove ResolveScope below [multicast] from lsl_api.cfg"
    # Two programs of one computer need no more.
    is_alone = ip_address(party.computer.address).is_loopback
    yield (note if is_alone else error)(what, why, fix)


def _translation(one: Party, other: Party) -> Iterator[Finding]:
    for party, peer in ((one, other), (other, one)):
        if party.computer.other != peer.computer.address:
            yield warning(
                f"{party.name} reaches {peer.name} on {party.computer.other}, but that is "
                f"{peer.computer.address} by itself",
                "Something between the two translates addresses (a router, a virtual machine, a "
                "container, WSL). LSL needs connections in both directions, and these seldom "
                "pass.",
                f"put both into one network: for a virtual machine or WSL, a bridged or mirrored "
                f"network; else a VPN between {one.name} and {other.name}",
            )
            return
