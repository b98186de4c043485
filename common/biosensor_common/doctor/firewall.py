"""Builds the commands that let LSL through the firewall of this or another computer."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

from biosensor_common.doctor.lsl_api_file import Ports

WINDOWS_RULE = "Biosensor Gateway"
"""Name of the rule that the installer can add."""
NEIGHBOURS = "LocalSubnet"
"""What Windows calls the computers of the same network."""
MAC = "System Settings > Network > Firewall > Options: allow incoming connections"
UDP, TCP = "udp", "tcp"


class Way(NamedTuple):
    """Ports that are to be open: *protocol* is ``udp`` or ``tcp``; the last one is included."""

    protocol: str
    first: int
    last: int

    def range(self, hyphen: str) -> str:
        """Return the ports as firewalls write them: one, or two and what stands between."""
        if self.first == self.last:
            return str(self.first)
        return f"{self.first}{hyphen}{self.last}"


def every(ports: Ports) -> tuple[Way, ...]:
    """Return all that LSL needs: discovery, and UDP and TCP of the streams."""
    return (
        Way(UDP, ports.discovery, ports.discovery),
        Way(UDP, ports.first, ports.last),
        Way(TCP, ports.first, ports.last),
    )


def opening(ports: Ports) -> str:
    """Return what opens the ports on this system, one command a line."""
    if sys.platform == "win32":
        return windows(ports)
    if sys.platform == "darwin":
        return MAC
    ways = every(ports)
    return f"with ufw: {ufw(ways)}\nwith firewalld: {firewalld(ways)}"


def ufw(ways: Sequence[Way]) -> str:
    """Return the command for ufw."""
    return " && ".join(f"sudo ufw allow {each.range(':')}/{each.protocol}" for each in ways)


def firewalld(ways: Sequence[Way]) -> str:
    """Return the command for firewalld."""
    ports = " ".join(f"--add-port={each.range('-')}/{each.protocol}" for each in ways)
    return f"sudo firewall-cmd --permanent {ports} && sudo firewall-cmd --reload"


def nftables(ways: Sequence[Way]) -> str:
    """Return the command for plain nftables, with table and chain as Linux systems name them.

    It holds until the next start of the computer.
    """
    return " && ".join(
        f"sudo nft insert rule inet filter input {protocol} dport '{{ {ports} }}' accept"
        for protocol, ports in _by_protocol(ways, ", ")
    )


def netsh(ways: Sequence[Way], who: str = NEIGHBOURS) -> str:
    """Return the commands for Windows that open ports to *who*, one a line."""
    return "\nand: ".join(
        f"{_add()} protocol={protocol.upper()} localport={ports} {_where(who)}"
        for protocol, ports in _by_protocol(ways, ",")
    )


def windows(ports: Ports) -> str:
    """Return the command for Windows, for a Command Prompt that is run as administrator.

    The installed program is allowed as such, as its installer does; from source, Python
    would be, so that the ports are opened instead.
    """
    if getattr(sys, "frozen", False):
        return f'as administrator: {_add()} program="{sys.executable}" {_where(NEIGHBOURS)}'
    return f"as administrator: {netsh(every(ports))}"


def _add() -> str:
    return f'netsh advfirewall firewall add rule name="{WINDOWS_RULE}" dir=in action=allow'


def _where(who: str) -> str:
    return f"remoteip={who} profile=private,domain"


def _by_protocol(ways: Sequence[Way], between: str) -> list[tuple[str, str]]:
    found: dict[str, list[str]] = {}
    for each in ways:
        found.setdefault(each.protocol, []).append(each.range("-"))
    return [(protocol, between.join(ranges)) for protocol, ranges in found.items()]
