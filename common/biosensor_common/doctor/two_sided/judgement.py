"""Says which side blocks what, and the command that opens it."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import ip_address

from biosensor_common.doctor.check import Finding, error, note, ok, warning
from biosensor_common.doctor.firewall import TCP, UDP, Way
from biosensor_common.doctor.streams import MAX_ROUND_TRIP_S
from biosensor_common.doctor.streams import listed as named
from biosensor_common.doctor.two_sided import remedies
from biosensor_common.doctor.two_sided.facts import End
from biosensor_common.doctor.two_sided.remedies import Party


def _judge_setting(one: Party, other: Party) -> Iterator[Finding]:
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


def judge(here: End, there: End) -> list[Finding]:
    """Judge both directions, the cause before what follows from it."""
    one, other = remedies.parties(here, there)
    found = [*_judge_setting(one, other)]
    for inner, outer in ((one, other), (other, one)):
        found += _entrance(inner, outer)
    for sender, receiver in ((one, other), (other, one)):
        found += _direction(sender, receiver, is_explained=any(map(_is_bad, found)))
    return found


def blocked_ways(inner: Party) -> list[Way]:
    """Return the ports at which nothing, or not everything, came in."""
    came, ports = inner.end.arrivals, inner.computer.ports
    found: list[Way] = []
    if came.discovery is False and not came.multicast:
        found.append(Way(UDP, ports.discovery, ports.discovery))
    for protocol, by_port in ((UDP, came.udp), (TCP, came.tcp)):
        if by_port and not all(by_port.values()):
            found.append(Way(protocol, ports.first, ports.last))
    return found


def _entrance(inner: Party, outer: Party) -> Iterator[Finding]:
    """Judge what comes in at one computer."""
    blocked = blocked_ways(inner)
    came = inner.end.arrivals
    if blocked:
        what = f"{inner.name} does not let in {remedies.listed(blocked)} from {outer.name}"
        why = f"{_part(inner)}{_consequence(inner, outer, blocked)}"
        fix = remedies.to_open(inner, inner.computer.other, blocked)
        yield (error if _hurts(inner, outer, blocked) else warning)(what, why, fix)
    elif came.multicast == ():
        yield _no_multicast(inner, outer)
    if came.discovery is None:
        yield warning(
            f"UDP {inner.computer.ports.discovery} is held for itself alone by a program of "
            f"{inner.name}",
            "LSL programs answer there; whether a firewall lets it in could not be tried.",
            f"{inner.on}: {remedies.doctor_command(inner.computer.program)} --only ports",
        )


def _no_multicast(inner: Party, outer: Party) -> Finding:
    what = f"multicast from {outer.name} does not reach {inner.name}, though its ports are open"
    why = (
        "The network between the two drops it, as Wi-Fi and VPNs do, or it leaves by another "
        f"adapter. So LSL on {outer.name} does not find the streams of {inner.name} by itself"
    )
    look, fix = outer.end.look, remedies.to_ask_directly(outer, outer.computer.other)
    if look.by_multicast:
        return note(what, f"{why}; now it did, perhaps by another adapter.", fix)
    if outer.computer.asks_the_other:
        return note(what, f"{why}, but it asks for them directly (KnownPeers).", fix)
    if look.directly:
        return error(what, f"{why}. Asked for directly (KnownPeers), they are found.", fix)
    return error(what, f"{why}, and not when it asks for them directly either.", fix)


def _part(inner: Party) -> str:
    """Say where the line runs if a part of the ports is open."""
    for protocol, by_port in ((UDP, inner.end.arrivals.udp), (TCP, inner.end.arrivals.tcp)):
        passing = [port for port, came in by_port.items() if came]
        if passing and len(passing) < len(by_port):
            closed = next(port for port, came in by_port.items() if not came)
            return f"{protocol.upper()} {passing[0]} comes in and {closed} does not. "
    return ""


def _consequence(inner: Party, outer: Party, blocked: list[Way]) -> str:
    kinds = {(each.protocol, each.first == each.last) for each in blocked}
    parts: list[str] = []
    if (UDP, True) in kinds:
        parts.append(f"{outer.name} does not find the streams of {inner.name}")
    if (TCP, False) in kinds:
        parts.append(f"no data of {inner.name} reaches {outer.name}")
    if (UDP, False) in kinds:
        parts.append(
            f"{outer.name} cannot ask {inner.name} directly nor for its clock, and {inner.name} "
            "may not hear the answers to its own questions"
        )
    return f"So {'; '.join(parts)}."


def _hurts(inner: Party, outer: Party, blocked: list[Way]) -> bool:
    """Whether liblsl itself was stopped; a firewall may let in answers and nothing else."""
    look = outer.end.look
    works = look.received and look.offset_s is not None
    is_found = bool(look.by_multicast) or (look.directly and outer.computer.asks_the_other)
    hears = inner.end.look.by_multicast is not False
    return not (works and is_found and hears) or any(each.protocol == TCP for each in blocked)


def _direction(sender: Party, receiver: Party, *, is_explained: bool) -> Iterator[Finding]:
    """Judge what LSL makes of the streams of one computer on the other one."""
    yield from _test_stream(sender, receiver, is_explained=is_explained)
    yield from _real_streams(sender, receiver)


def _test_stream(sender: Party, receiver: Party, *, is_explained: bool) -> Iterator[Finding]:
    look, title = receiver.end.look, f"{sender.name} -> {receiver.name}"
    ways = [
        *(["by multicast"] if look.by_multicast else []),
        *(["when asked for directly"] if look.directly else []),
    ]
    if look.received and look.offset_s is not None and look.round_trip_s is not None:
        yield from _clock(sender, receiver)
        if look.by_multicast or (look.by_multicast is None and look.directly):
            yield ok(f"{title}: a test stream is found {' and '.join(ways)}, and received")
        yield from _address(sender, receiver)
        if look.by_multicast is not False or is_explained:
            return
    if is_explained:
        return
    what = f"found {' and '.join(ways)}" if ways else "not found in any way"
    lacking = "" if look.received else ", but no sample came" if ways else ""
    yield error(
        f"{title}: a test stream is {what}{lacking}, though every test port is open",
        "Something between the two lets small packets through but not LSL: a security program, "
        "a VPN with a small MTU, or much traffic.",
        f"{receiver.on}: {remedies.doctor_command(receiver.computer.program)}\n"
        f"{sender.on}: {remedies.doctor_command(sender.computer.program)}",
    )


def _clock(sender: Party, receiver: Party) -> Iterator[Finding]:
    round_trip_s = receiver.end.look.round_trip_s or 0.0
    if round_trip_s > MAX_ROUND_TRIP_S:
        yield warning(
            f"{sender.name} -> {receiver.name}: the clock's offset is known to "
            f"{round_trip_s * 500:.0f} ms only",
            "Half of the round trip is how wrong the offset may be. Such values are those of busy "
            "or power-saving Wi-Fi.",
            "connect both by cable, or see the part Tuning of "
            "https://labstreaminglayer.readthedocs.io/info/lslapicfg.html",
        )


def _address(sender: Party, receiver: Party) -> Iterator[Finding]:
    found, asked = receiver.end.look.address, receiver.computer.other
    # An IPv6 address is of any of its adapters.
    if found != asked and "." in found and not ip_address(asked).is_loopback:
        yield note(
            f"{receiver.name} finds the streams of {sender.name} on {found}, not on {asked}",
            "The two are in more than one network, and LSL takes the address from which the "
            "answer came: of Wi-Fi and cable, perhaps the slower one.",
            "disconnect the network that the recording does not need",
        )


def _real_streams(sender: Party, receiver: Party) -> Iterator[Finding]:
    own = sender.end.own
    if not own:
        yield ok(f"{sender.name} sends no streams at the moment; a test stream stood in for them")
        return
    uids = {each.uid for each in receiver.end.seen}
    unseen = [each.name for each in own if each.uid not in uids]
    shut = [e.name for e in own if e.uid in uids and e.uid not in receiver.end.reached]
    amount = "1 stream" if len(own) == 1 else f"{len(own)} streams"
    again = (
        "mend what stands above, then ask again\nif nothing does, "
        f"{sender.on}: {remedies.doctor_command(sender.computer.program)} --only streams"
    )
    if unseen:
        yield error(
            f"{receiver.name} does not see {len(unseen)} of {amount} of {sender.name}: "
            f"{named(unseen)}",
            "LabRecorder and the node there do not see them either.",
            again,
        )
    if shut:
        yield error(
            f"{receiver.name} sees, but cannot receive from {sender.name}: {named(shut)}",
            "The port of their data does not open.",
            again,
        )
    if not unseen and not shut:
        address = receiver.end.look.address
        place = f", on {address}" if address else ""
        yield ok(f"{receiver.name} sees and opens {amount} of {sender.name}{place}")


def _is_bad(finding: Finding) -> bool:
    return finding.level.value in {"error", "warning"}
