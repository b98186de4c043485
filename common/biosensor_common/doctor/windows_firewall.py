"""Checks that the firewall of Windows lets other computers in."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import IntEnum, unique

from biosensor_common.doctor import firewall_rules, lsl_text
from biosensor_common.doctor.finding import Finding, note, ok, warning
from biosensor_common.doctor.lsl_api_file import Ports
from biosensor_gateway.doctor import firewall_policy
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.firewall_policy import Protocol, Rule, Treatment

_NETWORKS = r"SOFTWARE\Microsoft\Windows NT\CurrentVersion\NetworkList\Profiles"
# Where the installer's rule is meant to hold.
_PROFILES = ["Private", "Domain"]
_WHY = (
    "Other computers see the streams of this one only if it lets them in; LabRecorder on this "
    "computer does not need that."
)


@unique
class Network(IntEnum):
    """What Windows takes a network for, as in the registry."""

    PUBLIC = 0
    PRIVATE = 1
    DOMAIN = 2


def examine(context: Context) -> Iterator[Finding]:
    """Look for rules that let this program in or block it, and what the network is taken for."""
    if sys.platform != "win32":
        return
    latest = latest_network()
    network = None if latest is None else latest[1]
    yield from judge_rules(
        firewall_policy.rules(),
        _own_program(),
        lsl_text.ports(context.config),
        network,
        {each: firewall_policy.treatment(each) for each in _profiles(network)},
    )
    if latest is not None:
        yield judge_network(*latest)


def _own_program() -> str:
    # The python.exe of a virtual environment only starts the one that it was made of.
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
    """Judge which rules let a program receive what LSL needs.

    Parameters
    ----------
    rules
        Of the firewall; None if they cannot be read.
    program
        Full path.
    ports
        Of LSL.
    network
        What Windows takes the present network for; None if nobody knows.
    treatments
        Of each kind of network; one that is not there is an ordinary one.
    """
    opening = firewall_rules.windows(ports) + "\nor install again with 'Firewall rule' ticked"
    if rules is None:
        yield note("the rules of Windows' firewall cannot be read", _WHY, opening)
        return
    treated = {each: treatments.get(each, Treatment()) for each in _profiles(network)}
    # One that is off needs no rule.
    on = {profile: treatment for profile, treatment in treated.items() if treatment.is_on}
    if not on:
        yield ok(
            f"the firewall of Windows is off in {_kinds(treated)} networks, so it holds nothing "
            "back; that of another program may"
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
        what = f"no rule of the firewall lets {' and '.join(closed)} in to this program"
        yield note(what + _nearly(named, program, on), _WHY, opening)
    elif not blocking and not shut:
        names = ", ".join(dict.fromkeys(repr(rule.name) for rule in allowing))
        yield ok(f"the firewall lets this program in: {names}")


def _is_in_force(rule: Rule, treated: Mapping[str, Treatment]) -> bool:
    return any(
        rule.holds_in(profile) and (treatment.heeds_local_rules or not rule.is_local)
        for profile, treatment in treated.items()
    )


def _shut(profiles: Iterable[str]) -> Finding:
    return warning(
        f"the firewall lets nobody in, in {_kinds(profiles)} networks, whatever its rules say",
        _WHY,
        "Windows Security > Firewall & network protection > the network > untick 'Blocks all "
        "incoming connections'; where it is grey, ask who manages this PC",
    )


def _unheeded(profiles: Iterable[str], closed: Sequence[str], program: str) -> Finding:
    return warning(
        f"in {_kinds(profiles)} networks the firewall heeds only rules of who manages this PC, "
        f"and none of those lets {' and '.join(closed)} in to this program",
        _WHY,
        f"ask them for a rule for {program}, or for local rules to be merged",
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
        "A rule that blocks wins over all that allow, so other computers do not see the streams. "
        "Windows makes such rules when its question is answered with Cancel.",
        f"as administrator: wf.msc > Inbound Rules > {rule.name} > Disable Rule",
    )


def _nearly(rules: Iterable[Rule], program: str, profiles: Iterable[str]) -> str:
    """Say why the installer's rule, if it is there, is none for this program and network."""
    rule = next((each for each in rules if each.name == firewall_rules.WINDOWS_RULE), None)
    if rule is None:
        return ""
    if not rule.is_active:
        why = "is switched off"
    elif not rule.allows:
        why = "blocks"
    elif not rule.is_for(program):
        why = f"is for {rule.program}"
    elif not any(map(rule.holds_in, profiles)):
        why = f"holds in {_kinds(rule.profiles)} networks only"
    else:
        why = "is for other ports or protocols"
    return f"; the rule {rule.name!r} {why}"


def judge_network(name: str, network: Network) -> Finding:
    """Judge what Windows takes the network for."""
    if network is not Network.PUBLIC:
        return ok(f"Windows takes the network {name} for {network.name.lower()}")
    return warning(
        f"Windows takes the network {name}, the latest one, for public",
        "There it lets nobody in, and the rule of the installer does not hold.",
        "Settings > Network & internet > the network's properties > Private network",
    )


def latest_network() -> tuple[str, Network] | None:
    """Return the network that was connected last, which most often is the present one."""
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
    """Make a SYSTEMTIME comparable: year, month, (weekday,) day, and the time of the day."""
    fields = [system_time[at : at + 2][::-1] for at in range(0, len(system_time), 2)]
    return b"".join(fields[:2] + fields[3:])
