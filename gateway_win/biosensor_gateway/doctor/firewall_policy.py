r"""Reads the rules of the firewall of Windows from the registry.

netsh tells them in the language of the system; the registry has the same words everywhere.
Format of a rule: [MS-GPFAS] 2.2.2.19, for instance ``v2.31|Action=Allow|Active=TRUE|Dir=In|
Protocol=17|Profile=Private|LPort=16571|App=C:\x.exe|Name=LSL|``.
"""

from __future__ import annotations

import ntpath
import os
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum, unique

_FOLDER = r"SYSTEM\CurrentControlSet\Services\SharedAccess\Parameters\FirewallPolicy"
_RULES = rf"{_FOLDER}\FirewallRules"
_RULES_OF_DOMAIN = r"SOFTWARE\Policies\Microsoft\WindowsFirewall\FirewallRules"
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
    """

    name: str
    allows: bool
    is_active: bool = True
    program: str = ""
    protocols: frozenset[Protocol] = frozenset(Protocol)
    ports: tuple[tuple[int, int], ...] | None = None
    profiles: frozenset[str] = frozenset()

    def holds_in(self, profile: str) -> bool:
        """Whether it is in force in networks of a kind."""
        return not self.profiles or profile in self.profiles

    def is_for(self, program: str) -> bool:
        """Whether it concerns a program, given by its full path."""
        return not self.program or same_file(self.program, program)

    def opened(self, wanted: Iterable[int]) -> set[int]:
        """Return those of the ports that it concerns."""
        if self.ports is None:
            return set(wanted)
        return {each for each in wanted if any(low <= each <= high for low, high in self.ports)}


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
    """Return the rules of this PC and of its domain; None where they cannot be read."""
    if sys.platform != "win32":
        return None
    import winreg  # Windows only

    found: list[Rule] = []
    for path in (_RULES, _RULES_OF_DOMAIN):
        try:
            with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, path) as key:
                texts = [winreg.EnumValue(key, at)[1] for at in range(winreg.QueryInfoKey(key)[1])]
        except FileNotFoundError:
            if path == _RULES:
                return None
            continue
        except OSError:
            return None
        found.extend(rule for rule in map(read_rule, map(str, texts)) if rule is not None)
    return found
