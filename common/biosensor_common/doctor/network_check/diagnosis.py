"""Evaluates which of two computers blocks what, with the command that opens it, and a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from ipaddress import ip_address
from typing import NamedTuple

from biosensor_common.doctor import firewall
from biosensor_common.doctor.check import NODE, Finding, error, note, ok, warning
from biosensor_common.doctor.firewall import TCP, UDP, Way
from biosensor_common.doctor.lsl_checks import MAX_ROUND_TRIP_S
from biosensor_common.doctor.lsl_checks import listed as named
from biosensor_common.doctor.network_check.facts import Arrivals, Computer, End
from biosensor_common.doctor.report import printable
from biosensor_common.terminal import shortened

HERE = "this computer"
_NAME_WIDTH = 24
_SYSTEMS = {"win32": "Windows", "linux": "Linux", "darwin": "macOS"}


class Party(NamedTuple):
    """One of the two computers, with its name in sentences."""

    end: End
    name: str
    """Its host name, or "this computer"."""
    on: str
    """Where a command is to be typed: "on robot", or "here"."""

    @property
    def computer(self) -> Computer:
        """The computer's own facts."""
        return self.end.computer

    @property
    def doctor(self) -> str:
        """The command that starts doctor there."""
        return doctor_command(self.computer.program)


def _parties(here: End, there: End) -> tuple[Party, Party]:
    name = shortened(printable(there.computer.name), _NAME_WIDTH)
    if not name or there.computer.name == here.computer.name:
        name = "the other computer"
    return Party(here, HERE, "here"), Party(there, name, f"on {name}")


def doctor_command(program: str) -> str:
    """Return the command that starts doctor on the computer of a program."""
    return "python3 -m lsl_to_ros.doctor" if program == NODE else "biosensor-gateway doctor"


def judge(here: End, there: End) -> list[Finding]:
    """Return findings about what each side blocks and how to open it, causes first."""
    one, other = _parties(here, there)
    found = [*_judge_setting(one, other)]
    for inner, outer in ((one, other), (other, one)):
        found += _entrance(inner, outer)
    for sender, receiver in ((one, other), (other, one)):
        found += _direction(sender, receiver, is_explained=any(map(_is_bad, found)))
    return found


def _judge_setting(one: Party, other: Party) -> Iterator[Finding]:
    """Compare sessions, ports, scopes and addresses."""
    if one.computer.session != other.computer.session:
        yield error(
            f"the LSL session is {one.computer.session} on {one.name} and "
            f"{other.computer.session} on {other.name}",
            "LSL programs see only streams in their own session.",
            "use the same on both: SessionID below [lab] in lsl_api.cfg, or session_id of the "
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
                "LSL programs ask on another port, where nothing answers.",
                f"use the same {key} below [ports] in lsl_api.cfg on both, or none",
            )


def _scope(party: Party) -> Iterator[Finding]:
    if not party.computer.keeps_to_itself:
        return
    what = f"LSL on {party.name} is restricted to its own computer (ResolveScope is machine)"
    why = "It looks for streams only there, and is found only there; multicast was not tested."
    fix = f"{party.on}: remove ResolveScope below [multicast] from lsl_api.cfg"
    # For two programs on one computer this is enough.
    is_alone = ip_address(party.computer.address).is_loopback
    yield (note if is_alone else error)(what, why, fix)


def _translation(one: Party, other: Party) -> Iterator[Finding]:
    for party, peer in ((one, other), (other, one)):
        if party.computer.other != peer.computer.address:
            yield warning(
                f"{party.name} reaches {peer.name} on {party.computer.other}, but its own "
                f"address is {peer.computer.address}",
                "Something between the two translates addresses (a router, a virtual machine, a "
                "container, WSL). LSL needs connections in both directions, and these seldom "
                "pass.",
                "put both into one network: for a virtual machine or WSL, a bridged or mirrored "
                f"network; otherwise a VPN between {one.name} and {other.name}",
            )
            return


def _blocked_ways(inner: Party) -> list[Way]:
    """Return the ports that received nothing, or not everything."""
    came, ports = inner.end.arrivals, inner.computer.ports
    found: list[Way] = []
    if came.discovery is False and not came.multicast:
        found.append(Way(UDP, ports.discovery, ports.discovery))
    for protocol, by_port in ((UDP, came.udp), (TCP, came.tcp)):
        if by_port and not all(by_port.values()):
            found.append(Way(protocol, ports.first, ports.last))
    return found


def _entrance(inner: Party, outer: Party) -> Iterator[Finding]:
    """Evaluate what one computer received."""
    blocked = _blocked_ways(inner)
    came = inner.end.arrivals
    if blocked:
        what = f"{inner.name} blocks {firewall.listed(blocked)} from {outer.name}"
        why = f"{_part(inner)}{_consequence(inner, outer, blocked)}"
        fix = _to_open(inner, blocked)
        yield (error if _hurts(inner, outer, blocked) else warning)(what, why, fix)
    elif came.multicast == ():
        yield _no_multicast(inner, outer)
    if came.discovery is None:
        yield warning(
            f"UDP {inner.computer.ports.discovery} is held exclusively by a program on "
            f"{inner.name}",
            "LSL programs answer there; it could not be tested whether a firewall allows it.",
            f"{inner.on}: {inner.doctor} --only ports",
        )


def _no_multicast(inner: Party, outer: Party) -> Finding:
    what = f"multicast from {outer.name} does not reach {inner.name}, though its ports are open"
    why = (
        "The network between the two drops it, as Wi-Fi and VPNs do, or it leaves by another "
        f"adapter. So LSL on {outer.name} does not find the streams of {inner.name} "
        "automatically"
    )
    look, fix = outer.end.look, _to_ask_directly(outer)
    if look.by_multicast:
        return note(what, f"{why}; now it did, perhaps by another adapter.", fix)
    if outer.computer.asks_the_other:
        return note(what, f"{why}, but it asks for them directly (KnownPeers).", fix)
    if look.directly:
        return error(what, f"{why}. When asked for directly (KnownPeers), they are found.", fix)
    return error(what, f"{why}, and not when it asks for them directly either.", fix)


def _part(inner: Party) -> str:
    """Return a sentence about which ports are open, if only a part of them is."""
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
            "may not receive the answers to its own queries"
        )
    return f"So {'; '.join(parts)}."


def _hurts(inner: Party, outer: Party, blocked: list[Way]) -> bool:
    """Whether liblsl itself was blocked; a firewall may let in answers and nothing else."""
    look = outer.end.look
    works = look.received and look.offset_s is not None
    is_found = bool(look.by_multicast) or (look.directly and outer.computer.asks_the_other)
    hears = inner.end.look.by_multicast is not False
    return not (works and is_found and hears) or any(each.protocol == TCP for each in blocked)


def _direction(sender: Party, receiver: Party, *, is_explained: bool) -> Iterator[Finding]:
    """Evaluate how LSL on one computer finds and receives the other one's streams."""
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
    what = f"found {' and '.join(ways)}" if ways else "not found at all"
    lacking = "" if look.received else ", but no sample came" if ways else ""
    yield error(
        f"{title}: a test stream is {what}{lacking}, although every test port is open",
        "Something between the two lets small packets through but not LSL: a security program, "
        "a VPN with a small MTU, or much traffic.",
        f"{receiver.on}: {receiver.doctor}\n{sender.on}: {sender.doctor}",
    )


def _clock(sender: Party, receiver: Party) -> Iterator[Finding]:
    round_trip_s = receiver.end.look.round_trip_s or 0.0
    if round_trip_s > MAX_ROUND_TRIP_S:
        yield warning(
            f"{sender.name} -> {receiver.name}: the clock's offset is known to "
            f"{round_trip_s * 500:.0f} ms only",
            "The offset may be wrong by half of the round trip. Such values come from busy or "
            "power-saving Wi-Fi.",
            "connect both by cable, or see Tuning in "
            "https://labstreaminglayer.readthedocs.io/info/lslapicfg.html",
        )


def _address(sender: Party, receiver: Party) -> Iterator[Finding]:
    found, asked = receiver.end.look.address, receiver.computer.other
    # An IPv6 address does not show which adapter was used.
    if found != asked and "." in found and not ip_address(asked).is_loopback:
        yield note(
            f"{receiver.name} finds the streams of {sender.name} on {found}, not on {asked}",
            "The two share more than one network, and LSL uses the address from which the answer "
            "came: with Wi-Fi and cable, perhaps the slower one.",
            "disconnect the network that the recording does not need",
        )


def _real_streams(sender: Party, receiver: Party) -> Iterator[Finding]:
    own = sender.end.own
    if not own:
        yield ok(f"{sender.name} sends no streams at the moment; a test stream was used instead")
        return
    uids = {each.uid for each in receiver.end.seen}
    unseen = [each.name for each in own if each.uid not in uids]
    shut = [e.name for e in own if e.uid in uids and e.uid not in receiver.end.reached]
    amount = "1 stream" if len(own) == 1 else f"{len(own)} streams"
    again = (
        f"fix the problems above, then test again\nif there are none, {sender.on}: "
        f"{sender.doctor} --only streams"
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


def _to_open(party: Party, ways: Sequence[Way]) -> str:
    """Return the commands that open ports of one computer to the other, one per line."""
    computer = party.computer
    who = firewall.NEIGHBOURS if computer.is_near else computer.other
    return f"{party.on}, {firewall.opening_on(computer.system, computer.firewalls, ways, who)}"


def _to_ask_directly(party: Party) -> str:
    """Return how LSL programs of a computer are made to ask the other one without multicast."""
    address = party.computer.other
    if party.computer.program == NODE:
        return (
            f"{party.on}, start the node with: ros2 launch lsl_to_ros lsl_to_ros.launch.py "
            f'known_peers:="[{address}]"'
        )
    return (
        f"{party.on}: biosensor-gateway config lsl --for two-pc --peer {address}\n"
        "and start LabRecorder there again (this writes KnownPeers into lsl_api.cfg)"
    )


def sides_of(here: End, there: End) -> tuple[str, str]:
    """Return one line about each computer."""
    one = _described("This computer", here.computer)
    return one, _described("The other one", there.computer)


def rows(here: End, there: End) -> Iterator[tuple[str, str, str]]:
    """Yield the table, its heading first: title, result towards here, result towards there."""
    one, other = _parties(here, there)
    left, right = _short(other), _short(one)
    yield "", f"{left} -> {right}", f"{right} -> {left}"
    ports = here.computer.ports
    several = f"{ports.first} to {ports.last}"
    # What a computer received shows the direction from the other one.
    cells: tuple[tuple[str, Callable[[End, End], str]], ...] = (
        (f"multicast, UDP {ports.discovery}", lambda _, to: _multicast(to.arrivals)),
        (f"UDP {ports.discovery}", lambda _, to: _word(to.arrivals.discovery)),
        (f"UDP {several}", lambda _, to: _words(to.arrivals.udp)),
        (f"TCP {several}", lambda _, to: _words(to.arrivals.tcp)),
        ("test stream found by multicast", lambda _, to: _word(to.look.by_multicast)),
        ("  found when asked for directly", lambda _, to: _word(to.look.directly)),
        ("  received", lambda _, to: _word(to.look.received)),
        ("  round trip", lambda _, to: _milliseconds(to.look.round_trip_s)),
        ("streams seen", _seen),
        ("  whose port opens", _reached),
    )
    for title, cell in cells:
        yield title, cell(there, here), cell(here, there)


def _described(title: str, computer: Computer) -> str:
    system = _SYSTEMS.get(computer.system, "another system")
    program = "the node" if computer.program == NODE else "the agent"
    return f"{title}: {printable(computer.name)[:30]}, {computer.address}, {system}, {program}"


def _short(party: Party) -> str:
    if party.name == HERE:
        return "here"
    return party.name if len(party.name) <= 10 else "there"


def _multicast(arrivals: Arrivals) -> str:
    return "-" if arrivals.multicast is None else _word(bool(arrivals.multicast))


def _word(found: bool | None) -> str:
    return "-" if found is None else "yes" if found else "NO"


def _words(by_port: Mapping[int, bool]) -> str:
    if not by_port:
        return "-"
    return "PART" if len(set(by_port.values())) == 2 else _word(all(by_port.values()))


def _milliseconds(seconds: float | None) -> str:
    return "NO" if seconds is None else f"{seconds * 1e3:.1f} ms"


def _seen(sender: End, receiver: End) -> str:
    uids = {each.uid for each in receiver.seen}
    return _of(sum(each.uid in uids for each in sender.own), sender)


def _reached(sender: End, receiver: End) -> str:
    return _of(sum(each.uid in receiver.reached for each in sender.own), sender)


def _of(count: int, sender: End) -> str:
    return f"{count} of {len(sender.own)}" if sender.own else "-"
