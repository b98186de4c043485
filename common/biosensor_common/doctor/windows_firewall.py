r"""Checks that the Windows firewall lets other computers in.

Rules and settings are read from the registry, because netsh prints them in the language of the
system. Format of a rule: [MS-GPFAS] 2.2.2.19, for instance
``v2.31|Action=Allow|Active=TRUE|Dir=In|Protocol=17|Profile=Private|LPort=16571|App=C:\x.exe|
Name=LSL|``. Settings of a kind of network: [MS-GPFAS] 2.2.3.
"""

from __future__ import annotations

import ntpath
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, unique

from biosensor_common.doctor import firewall
from biosensor_common.doctor.check import Context, Finding, note, ok, warning
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import Ports

_FOLDER = r"SYSTEM\CurrentControlSet\Services\SharedAccess\Parameters\FirewallPolicy"
_OF_DOMAIN = r"SOFTWARE\Policies\Microsoft\WindowsFirewall"
_OF_DEVICE_MANAGEMENT = rf"{_FOLDER}\Mdm"
_MANAGED = (_OF_DOMAIN, _OF_DEVICE_MANAGEMENT)
_RULES = "FirewallRules"
_VARIABLE = re.compile(r"%([^%]+)%")
# Rules with these keys apply to a service or a packaged app, not to ordinary programs.
_FOR_OTHERS = ("Svc", "AppPkgId", "PFN")
_ANY_PROTOCOL = 256


@unique
class Protocol(IntEnum):
    """The transport protocols of LSL, with their IP protocol numbers."""

    TCP = 6
    UDP = 17


@dataclass(frozen=True, slots=True)
class Rule:
    """One inbound rule, which allows or blocks."""

    name: str
    allows: bool
    is_active: bool = True
    program: str = ""  # Full path; empty for all programs.
    protocols: frozenset[Protocol] = frozenset(Protocol)
    ports: tuple[tuple[int, int], ...] | None = None  # Ranges, each with its end; None for all.
    # `Private`, `Domain`, `Public`; all of them if none is named.
    profiles: frozenset[str] = frozenset()
    # Whether the rule is set on this PC, not by its domain or device management.
    is_local: bool = True

    def holds_in(self, profile: str) -> bool:
        """Whether the rule applies to networks of this kind."""
        return not self.profiles or profile in self.profiles

    def is_for(self, program: str) -> bool:
        """Whether the rule applies to a program, given by its full path."""
        return not self.program or same_file(self.program, program)

    def opened(self, wanted: Iterable[int]) -> set[int]:
        """Return the ports among these to which the rule applies."""
        if self.ports is None:
            return set(wanted)
        return {each for each in wanted if any(low <= each <= high for low, high in self.ports)}


@dataclass(frozen=True, slots=True)
class Treatment:
    """How the firewall treats networks of one kind."""

    is_on: bool = True
    lets_in: bool = True
    """Whether rules can let anything in at all."""
    heeds_local_rules: bool = True
    """Whether rules of this PC apply, and not only those of its domain."""


_NETWORKS = r"SOFTWARE\Microsoft\Windows NT\CurrentVersion\NetworkList\Profiles"
# The kinds of networks to which the installer's rule applies.
_PROFILES = ["Private", "Domain"]
_WHY = (
    "Other computers see this computer's streams only if it allows them in; LabRecorder on this "
    "computer does not need that."
)


@unique
class Network(IntEnum):
    """Windows' category of a network, as in the registry."""

    PUBLIC = 0
    PRIVATE = 1
    DOMAIN = 2


def same_file(one: str, other: str) -> bool:
    """Whether two Windows paths are of the same file; case is ignored."""
    return _plain(one) == _plain(other)


def _plain(path: str) -> str:
    return ntpath.normcase(ntpath.normpath(path.strip('"')))


def read_rule(text: str, variables: Mapping[str, str] = os.environ) -> Rule | None:
    """Parse a rule of the registry; None if it does not apply to LSL traffic of a program.

    The variables replace names such as ``%ProgramFiles%`` in the program's path.
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
    # Words such as RPC name ports that LSL does not use.
    return tuple(
        (int(low), int(high or low))
        for low, _, high in ranges
        if low.isdecimal() and (high or low).isdecimal()
    )


def _expanded(path: str, variables: Mapping[str, str]) -> str:
    known = {name.upper(): value for name, value in variables.items()}
    return _VARIABLE.sub(lambda found: known.get(found[1].upper(), found[0]), path)


def local_and_managed_rules() -> list[Rule] | None:
    """Return the rules of this PC and those of its management; None if they cannot be read."""
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
    # The key of the private profile still has its name from before there were three.
    own = {"Private": "Standard"}.get(profile, profile)
    local = _values(rf"{_FOLDER}\{own}Profile") or {}
    return merged(local, [_values(rf"{each}\{profile}Profile") or {} for each in _MANAGED])


def merged(local: Mapping[str, object], managed: Sequence[Mapping[str, object]]) -> Treatment:
    """Merge the settings of a PC with those of its management, which take precedence."""
    settings = dict(local)
    for each in managed:
        settings |= each
    return Treatment(
        is_on=settings.get("EnableFirewall", 1) != 0,
        lets_in=settings.get("DoNotAllowExceptions", 0) != 1,
        heeds_local_rules=all(each.get("AllowLocalPolicyMerge", 1) != 0 for each in managed),
    )


def _values(path: str) -> dict[str, object] | None:
    """Return the values of a registry key; None if it cannot be read."""
    if sys.platform != "win32":
        return None
    import winreg  # Windows only

    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, path) as key:
            entries = [winreg.EnumValue(key, at) for at in range(winreg.QueryInfoKey(key)[1])]
    except OSError:
        return None
    return {name: value for name, value, _ in entries}


def windows_firewall(context: Context) -> Iterator[Finding]:
    """Check the rules that allow or block this program, and the category of the network."""
    if sys.platform != "win32":
        return
    latest = latest_network()
    network = None if latest is None else latest[1]
    yield from judge_rules(
        local_and_managed_rules(),
        _own_program(),
        api_file.ports(context.config),
        network,
        {each: treatment(each) for each in _profiles(network)},
    )
    if latest is not None:
        yield judge_network(*latest)


def _own_program() -> str:
    # The python.exe of a virtual environment only starts the base interpreter.
    own = sys.executable
    return own if getattr(sys, "frozen", False) else getattr(sys, "_base_executable", own)


def _profiles(network: Network | None) -> list[str]:
    return _PROFILES if network is None else [network.name.capitalize()]


def judge_rules(
    rules: Iterable[Rule] | None,
    program: str,
    ports: Ports,
    network: Network | None,
    treatments: Mapping[str, Treatment],
) -> Iterator[Finding]:
    """Check which rules let a program, by its full path, receive what LSL needs.

    Rules are None if they cannot be read; the network is None if its category is unknown. Kinds
    of networks that are not among the treatments have default settings.
    """
    opening = firewall.windows(ports) + "\nor install again with 'Firewall rule' ticked"
    if rules is None:
        yield note("the rules of Windows' firewall cannot be read", _WHY, opening)
        return
    treated = {each: treatments.get(each, Treatment()) for each in _profiles(network)}
    # A firewall that is off needs no rule.
    on = {profile: treatment for profile, treatment in treated.items() if treatment.is_on}
    if not on:
        yield ok(
            f"Windows' firewall is off in {_kinds(treated)} networks, so it blocks nothing; "
            "another program's firewall may"
        )
        return
    shut = [profile for profile, treatment in on.items() if not treatment.lets_in]
    if shut:
        yield _shut(shut)
    named = list(rules)
    ours = [
        rule for rule in named if rule.is_active and rule.is_for(program) and _is_in_force(rule, on)
    ]
    needs = _needs(ports)
    blocking = [
        rule
        for rule in ours
        if not rule.allows and any(rule.opened(needs[each]) for each in rule.protocols)
    ]
    yield from map(_blocked, blocking)
    allowing = [rule for rule in ours if rule.allows]
    closed = [each.name for each in Protocol if not _is_open(allowing, each, needs[each])]
    deaf = [profile for profile, treatment in on.items() if not treatment.heeds_local_rules]
    if closed and deaf:
        yield _unheeded(deaf, closed, program)
    elif closed:
        what = f"no firewall rule allows {' and '.join(closed)} to this program"
        yield note(what + _nearly(named, program, on), _WHY, opening)
    elif not blocking and not shut:
        names = ", ".join(dict.fromkeys(repr(rule.name) for rule in allowing))
        yield ok(f"the firewall allows this program: {names}")


def _is_in_force(rule: Rule, treated: Mapping[str, Treatment]) -> bool:
    return any(
        rule.holds_in(profile) and (treatment.heeds_local_rules or not rule.is_local)
        for profile, treatment in treated.items()
    )


def _shut(profiles: Iterable[str]) -> Finding:
    return warning(
        f"the firewall blocks all incoming connections in {_kinds(profiles)} networks, whatever "
        "its rules say",
        _WHY,
        "Windows Security > Firewall & network protection > the network > untick 'Blocks all "
        "incoming connections'; if it is greyed out, ask the administrator of this PC",
    )


def _unheeded(profiles: Iterable[str], closed: Sequence[str], program: str) -> Finding:
    return warning(
        f"in {_kinds(profiles)} networks, the firewall uses only the rules of this PC's "
        f"administrator, and none of them allows {' and '.join(closed)} to this program",
        _WHY,
        f"ask the administrator for a rule for {program}, or for local rules to be merged",
    )


def _kinds(profiles: Iterable[str]) -> str:
    return " and ".join(sorted(profiles)).lower()


def _needs(ports: Ports) -> dict[Protocol, set[int]]:
    several = set(range(ports.first, ports.last + 1))
    return {Protocol.TCP: several, Protocol.UDP: several | {ports.discovery}}


def _is_open(allowing: Iterable[Rule], protocol: Protocol, needed: set[int]) -> bool:
    rules = [rule for rule in allowing if protocol in rule.protocols]
    return needed <= set[int]().union(*(rule.opened(needed) for rule in rules))


def _blocked(rule: Rule) -> Finding:
    protocols = " and ".join(each.name for each in sorted(rule.protocols))
    return warning(
        f"the firewall's rule {rule.name!r} blocks {protocols} to this program",
        "A blocking rule overrides all that allow, so other computers do not see the streams. "
        "Windows creates such rules when its question is answered with Cancel.",
        f"as administrator: wf.msc > Inbound Rules > {rule.name} > Disable Rule",
    )


def _nearly(rules: Iterable[Rule], program: str, profiles: Iterable[str]) -> str:
    """Return why the installer's rule, if it exists, does not apply to this program and network."""
    rule = next((each for each in rules if each.name == firewall.WINDOWS_RULE), None)
    if rule is None:
        return ""
    if not rule.is_active:
        why = "is switched off"
    elif not rule.allows:
        why = "blocks"
    elif not rule.is_for(program):
        why = f"is for {rule.program}"
    elif not any(map(rule.holds_in, profiles)):
        why = f"applies only in {_kinds(rule.profiles)} networks"
    else:
        why = "is for other ports or protocols"
    return f"; the rule {rule.name!r} {why}"


def judge_network(name: str, network: Network) -> Finding:
    """Check Windows' category of the network."""
    if network is not Network.PUBLIC:
        return ok(f"Windows treats the network {name} as {network.name.lower()}")
    return warning(
        f"Windows treats the network {name}, the latest one, as public",
        "There it blocks all incoming connections, and the installer's rule has no effect.",
        "Settings > Network & internet > the network's properties > Private network",
    )


def latest_network() -> tuple[str, Network] | None:
    """Return the network that was connected last, which is usually the present one."""
    if sys.platform != "win32":
        return None
    import winreg  # Windows only

    found: list[tuple[bytes, str, Network]] = []
    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, _NETWORKS) as profiles:
            for index in range(winreg.QueryInfoKey(profiles)[0]):
                with winreg.OpenKey(profiles, winreg.EnumKey(profiles, index)) as profile:
                    when, _ = winreg.QueryValueEx(profile, "DateLastConnected")
                    name, _ = winreg.QueryValueEx(profile, "ProfileName")
                    category, _ = winreg.QueryValueEx(profile, "Category")
                    found.append((sortable(bytes(when)), str(name), Network(category)))
    except (OSError, ValueError, TypeError):
        # Not every edition keeps this list.
        return None
    return max(found)[1:] if found else None


def sortable(system_time: bytes) -> bytes:
    """Return a SYSTEMTIME without its weekday, so that it can be compared."""
    fields = [system_time[at : at + 2][::-1] for at in range(0, len(system_time), 2)]
    return b"".join(fields[:2] + fields[3:])
