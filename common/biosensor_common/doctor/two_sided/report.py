"""Shows what both computers have found out: a table, then what is wrong and what opens it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from biosensor_common.doctor import report
from biosensor_common.doctor.check import Category, Check
from biosensor_common.doctor.report import Report, printable
from biosensor_common.doctor.two_sided.facts import NODE, Arrivals, Computer, End, as_message
from biosensor_common.doctor.two_sided.remedies import HERE, Party, parties

CHECK = Check("network", Category.NETWORK, "the way to another computer, tried from both sides", "")
_SYSTEMS = {"win32": "Windows", "linux": "Linux", "darwin": "macOS"}
_LABEL, _COLUMN = 36, 21


class Row(NamedTuple):
    """A line of the table: what, how it is from the other computer to here, and back."""

    label: str
    to_here: str
    to_there: str


def as_text(outcome: Report, ends: tuple[End, End] | None, encoding: str, width: int | None) -> str:
    """Return what a console of that encoding, and width, can show."""
    said = report.as_text(outcome, encoding, width)
    if ends is None:
        return said
    table = "\n".join(line.rstrip() for line in _table(*ends))
    return f"{table}\n\n{said}".encode(encoding, "replace").decode(encoding)


def as_json(outcome: Report, ends: tuple[End, End] | None) -> str:
    """Return the same for scripts, in ASCII; ``ends`` is null without a conversation."""
    content: Mapping[str, Any] = json.loads(report.as_json(outcome))
    told = (
        None if ends is None else dict(zip(("here", "there"), map(as_message, ends), strict=True))
    )
    return json.dumps({**content, "ends": told}, indent=2)


def sides(here: End, there: End) -> tuple[str, str]:
    """Return a line about each of the two computers."""
    one = _described("This computer", here.computer)
    return one, _described("The other one", there.computer)


def rows(here: End, there: End) -> Iterator[Row]:
    """Return what came in, and what LSL made of it, by direction; the headings first."""
    one, other = parties(here, there)
    left, right = _short(other), _short(one)
    yield Row("", f"{left} -> {right}", f"{right} -> {left}")
    ports = here.computer.ports
    several = f"{ports.first} to {ports.last}"
    # What comes in here is what the other one has sent.
    came = [here.arrivals, there.arrivals]
    yield Row(f"multicast, UDP {ports.discovery}", *map(_multicast, came))
    yield Row(f"UDP {ports.discovery}", *(_word(each.discovery) for each in came))
    yield Row(f"UDP {several}", *(_words(each.udp) for each in came))
    yield Row(f"TCP {several}", *(_words(each.tcp) for each in came))
    looks = [here.look, there.look]
    yield Row("test stream found by multicast", *(_word(each.by_multicast) for each in looks))
    yield Row("  found when asked for directly", *(_word(each.directly) for each in looks))
    yield Row("  received", *(_word(each.received) for each in looks))
    yield Row("  round trip", *(_milliseconds(each.round_trip_s) for each in looks))
    yield Row("streams that are seen", _seen(there, here), _seen(here, there))
    yield Row("  whose port opens", _reached(there, here), _reached(here, there))


def _table(here: End, there: End) -> Iterator[str]:
    yield from sides(here, there)
    yield ""
    for label, *cells in rows(here, there):
        yield f"{label:<{_LABEL}}" + "".join(f"{cell:<{_COLUMN}}" for cell in cells)


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
