r"""Reads rules and settings of the firewall of Windows from the registry.

netsh tells them in the language of the system; the registry has the same words everywhere.
Format of a rule: [MS-GPFAS] 2.2.2.19, for instance ``v2.31|Action=Allow|Active=TRUE|Dir=In|
Protocol=17|Profile=Private|LPort=16571|App=C:\x.exe|Name=LSL|``. Settings of a kind of network:
[MS-GPFAS] 2.2.3.
"""

from __future__ import annotations

import ntpath
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, unique

_FOLDER = r"SYSTEM\CurrentControlSet\Services\SharedAccess\Parameters\FirewallPolicy"
_OF_DOMAIN = r"SOFTWARE\Policies\Microsoft\WindowsFirewall"
_OF_DEVICE_MANAGEMENT = rf"{_FOLDER}\Mdm"
_MANAGED = (_OF_DOMAIN, _OF_DEVICE_MANAGEMENT)
_RULES = "FirewallRules"
_VARIABLE = re.compile(r"%([^%]+)%")
# Rules for a service, or for a packaged app, are for no ordinary program.
_FOR_OTHERS = ("Svc", "AppPkgId", "PFN")
_ANY_PROTOCOL = 256


@unique
class Protocol(IntEnum):
    """What LSL is carried by, with the numbers of IP."""

    TCP = 6
    UDP = 17


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule for what comes in.

    Attributes
    ----------
    name
        As the user sees it.
    allows
        Whether it lets in; else it blocks.
    program
        Full path; empty for all programs.
    protocols
        Of those that LSL uses.
    ports
        Ranges, each with its end; None for all.
    profiles
        ``Private``, ``Domain``, ``Public``; all of them if none is named.
    is_local
        Whether this PC has it, not its domain or device management.
    """

    name: str
    allows: bool
    is_active: bool = True
    program: str = ""
    protocols: frozenset[Protocol] = frozenset(Protocol)
    ports: tuple[tuple[int, int], ...] | None = None
    profiles: frozenset[str] = frozenset()
    is_local: bool = True

    def holds_in(self, profile: str) -> bool:
        """Whether it is for networks of a kind."""
        return not self.profiles or profile in self.profiles

    def is_for(self, program: str) -> bool:
        """Whether it concerns a program, given by its full path."""
        return not self.program or same_file(self.program, program)

    def opened(self, wanted: Iterable[int]) -> set[int]:
        """Return those of the ports that it concerns."""
        if self.ports is None:
            return set(wanted)
        return {each for each in wanted if any(low <= each <= high for low, high in self.ports)}


@dataclass(frozen=True, slots=True)
class Treatment:
    """How the firewall treats networks of one kind.

    Attributes
    ----------
    is_on
        Else it holds nothing back.
    lets_in
        Whether rules can let anything in at all.
    heeds_local_rules
        Whether those of this PC are in force, and not only those of its domain.
    """

    is_on: bool = True
    lets_in: bool = True
    heeds_local_rules: bool = True


def same_file(one: str, other: str) -> bool:
    """Whether two paths of Windows are the same, apart from upper and lower case."""
    return _plain(one) == _plain(other)


def _plain(path: str) -> str:
    return ntpath.normcase(ntpath.normpath(path.strip('"')))


def read_rule(text: str, variables: Mapping[str, str] = os.environ) -> Rule | None:
    """Read a rule as the registry has it.

    Parameters
    ----------
    variables
        What stands for names such as ``%ProgramFiles%`` in the program's path.

    Returns
    -------
    Rule or None
        None for a rule that concerns nothing that LSL sends to an ordinary program.
    """
    fields: dict[str, list[str]] = {}
    for entry in text.split("|"):
        key, equals, value = entry.partition("=")
        if equals:
            fields.setdefault(key, []).append(value)
    last = {key: values[-1] for key, values in fields.items()}
    protocols = _protocols(last.get("Protocol"))
    action = last.get("Action")
    is_ours = last.get("Dir") == "In" and protocols and not any(key in last for key in _FOR_OTHERS)
    if not is_ours or action not in {"Allow", "Block"}:
        return None
    return Rule(
        last.get("Name", ""),
        allows=action == "Allow",
        is_active=last.get("Active") == "TRUE",
        program=_expanded(last.get("App", ""), variables),
        protocols=protocols,
        ports=_ports([*fields.get("LPort", []), *fields.get("LPort2_10", [])]),
        profiles=frozenset(fields.get("Profile", [])),
    )


def _protocols(number: str | None) -> frozenset[Protocol]:
    if number is None or number == str(_ANY_PROTOCOL):
        return frozenset(Protocol)
    return frozenset(each for each in Protocol if str(each.value) == number)


def _ports(written: list[str]) -> tuple[tuple[int, int], ...] | None:
    if not written:
        return None
    ranges = [each.partition("-") for each in written]
    # There are words, too, such as RPC: ports that LSL does not use.
    return tuple(
        (int(low), int(high or low))
        for low, _, high in ranges
        if low.isdecimal() and (high or low).isdecimal()
    )


def _expanded(path: str, variables: Mapping[str, str]) -> str:
    known = {name.upper(): value for name, value in variables.items()}
    return _VARIABLE.sub(lambda found: known.get(found[1].upper(), found[0]), path)


def rules() -> list[Rule] | None:
    """Return the rules of this PC and of who manages it; None where they cannot be read."""
    local = _values(rf"{_FOLDER}\{_RULES}")
    if local is None:
        return None
    found = list(filter(None, map(read_rule, map(str, local.values()))))
    for folder in _MANAGED:
        managed = map(read_rule, map(str, (_values(rf"{folder}\{_RULES}") or {}).values()))
        found.extend(replace(rule, is_local=False) for rule in managed if rule is not None)
    return found


def treatment(profile: str) -> Treatment:
    """Return how networks of a kind are treated: ``Private``, ``Domain`` or ``Public``."""
    # The private one has the name that it had before there were three.
    own = {"Private": "Standard"}.get(profile, profile)
    local = _values(rf"{_FOLDER}\{own}Profile") or {}
    return merged(local, [_values(rf"{each}\{profile}Profile") or {} for each in _MANAGED])


def merged(local: Mapping[str, object], managed: Sequence[Mapping[str, object]]) -> Treatment:
    """Join the settings of a PC with those of who manages it, which come first."""
    settings = dict(local)
    for each in managed:
        settings |= each
    return Treatment(
        is_on=settings.get("EnableFirewall", 1) != 0,
        lets_in=settings.get("DoNotAllowExceptions", 0) != 1,
        heeds_local_rules=all(each.get("AllowLocalPolicyMerge", 1) != 0 for each in managed),
    )


def _values(path: str) -> dict[str, object] | None:
    """Return what is in a key of the registry; None if it cannot be read."""
    if sys.platform != "win32":
        return None
    import winreg  # Windows only

    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, path) as key:
            entries = [winreg.EnumValue(key, at) for at in range(winreg.QueryInfoKey(key)[1])]
    except OSError:
        return None
    return {name: value for name, value, _ in entries}
