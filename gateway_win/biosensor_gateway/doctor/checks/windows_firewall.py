"""Checks that the firewall of Windows lets other computers in."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from enum import IntEnum, unique

from biosensor_common.doctor import firewall_rules, lsl_text, programs
from biosensor_common.doctor.finding import Finding, note, ok, warning
from biosensor_gateway.doctor.context import Context

_NETWORKS = r"SOFTWARE\Microsoft\Windows NT\CurrentVersion\NetworkList\Profiles"


@unique
class Network(IntEnum):
    """What Windows takes a network for, as in the registry."""

    PUBLIC = 0
    PRIVATE = 1
    DOMAIN = 2


def examine(context: Context) -> Iterator[Finding]:
    """Look for the rule of the installer, and for what the network is taken for."""
    if sys.platform != "win32":
        return
    opening = firewall_rules.windows(lsl_text.ports(context.config))
    yield _rule(opening)
    latest = latest_network()
    if latest is not None:
        yield judge_network(*latest)


def _rule(opening: str) -> Finding:
    name = firewall_rules.WINDOWS_RULE
    show = ("netsh", "advfirewall", "firewall", "show", "rule", f"name={name}")
    there = programs.succeeds(*show)
    if there:
        return ok(f"the firewall has the rule {name!r}")
    what = "cannot be asked" if there is None else f"has no rule {name!r}"
    return note(
        f"the firewall of Windows {what}",
        "Other computers see the streams of this one only if it lets them in; LabRecorder on this "
        "computer does not need that.",
        opening + "\nor install again with 'Allow it through the firewall'",
    )


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
    import winreg  # noqa: PLC0415 - Windows only

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
