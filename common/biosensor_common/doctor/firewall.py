"""Returns the commands that open firewalls for LSL, and detects which firewalls are on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from biosensor_common import child
from biosensor_common.doctor.check import Context, Finding, note, ok
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import Ports

WINDOWS_RULE = "Biosensor Gateway"
"""Name of the rule that the installer adds on request."""
NEIGHBOURS = "LocalSubnet"
"""Windows' name for the computers of the same network."""
MAC = "System Settings > Network > Firewall > Options: allow incoming connections"
UDP, TCP = "udp", "tcp"


class Way(NamedTuple):
    """A range of ports to open, including the last one; *protocol* is ``udp`` or ``tcp``."""

    protocol: str
    first: int
    last: int

    def range(self, hyphen: str) -> str:
        """Return the ports in a firewall's syntax: one number, or two joined by *hyphen*."""
        if self.first == self.last:
            return str(self.first)
        return f"{self.first}{hyphen}{self.last}"


def listed(ways: Sequence[Way]) -> str:
    """Return ports for a sentence: ``UDP 16571, 16572 to 16827 and TCP 5 to 9``."""
    return " and ".join(
        f"{protocol.upper()} {ports}" for protocol, ports in _by_protocol(ways, ", ", " to ")
    )


def every(ports: Ports) -> tuple[Way, ...]:
    """Return all ports that LSL needs: discovery, and UDP and TCP of the streams."""
    return (
        Way(UDP, ports.discovery, ports.discovery),
        Way(UDP, ports.first, ports.last),
        Way(TCP, ports.first, ports.last),
    )


def opening(ports: Ports) -> str:
    """Return the commands that open the ports on this system, one per line."""
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

    The rule is lost at the next start of the computer.
    """
    return " && ".join(
        f"sudo nft insert rule inet filter input {protocol} dport '{{ {ports} }}' accept"
        for protocol, ports in _by_protocol(ways, ", ")
    )


def netsh(ways: Sequence[Way], who: str = NEIGHBOURS) -> str:
    """Return the commands for Windows that open ports to *who*, one per line."""
    return "\nand: ".join(
        f"{_add()} protocol={protocol.upper()} localport={ports} {_where(who)}"
        for protocol, ports in _by_protocol(ways, ",")
    )


def windows(ports: Ports) -> str:
    """Return the command for Windows, for a Command Prompt that is run as administrator.

    For an installed program the program itself is allowed, as by its installer. From source
    that would allow Python, so the ports are opened instead.
    """
    if getattr(sys, "frozen", False):
        return f'as administrator: {_add()} program="{sys.executable}" {_where(NEIGHBOURS)}'
    return f"as administrator: {netsh(every(ports))}"


def _add() -> str:
    return f'netsh advfirewall firewall add rule name="{WINDOWS_RULE}" dir=in action=allow'


def _where(who: str) -> str:
    return f"remoteip={who} profile=private,domain"


def _by_protocol(ways: Sequence[Way], between: str, hyphen: str = "-") -> list[tuple[str, str]]:
    found: dict[str, list[str]] = {}
    for each in ways:
        found.setdefault(each.protocol, []).append(each.range(hyphen))
    return [(protocol, between.join(ranges)) for protocol, ranges in found.items()]


BY_FIREWALL: dict[str, Callable[[Sequence[Way]], str]] = {
    "ufw": ufw,
    "firewalld": firewalld,
    "nftables": nftables,
}
"""Functions that return the commands, by the name of the Linux service."""
# Both build on nftables, so plain nftables is used only without them.
_FRONT_ENDS = ("ufw", "firewalld")


def active_firewalls() -> tuple[str, ...]:
    """Return which of `BY_FIREWALL` are active here, according to systemd."""
    if sys.platform != "linux":
        return ()
    ask = child.succeeds
    return tuple(name for name in BY_FIREWALL if ask("systemctl", "is-active", name))


def opening_on(system: str, firewalls: Sequence[str], ways: Sequence[Way], who: str) -> str:
    """Return the commands that open ports of a computer to *who*, one per line.

    Parameters
    ----------
    system
        ``sys.platform`` of that computer.
    firewalls
        Which of `BY_FIREWALL` are active there.
    """
    if system == "win32":
        return (
            f"as administrator: {netsh(ways, who)}\n"
            "a blocking rule overrides these; find it with: biosensor-gateway doctor --only "
            "windows_firewall"
        )
    if system == "darwin":
        return MAC
    if system == "linux":
        chosen = [name for name in _FRONT_ENDS if name in firewalls] or firewalls or BY_FIREWALL
        return "\n".join(f"with {name}: {BY_FIREWALL[name](ways)}" for name in chosen)
    return f"allow {listed(ways)} in its firewall"


def linux_firewall(context: Context) -> Iterator[Finding]:
    """Ask systemd for ufw and firewalld; only the administrator can read their rules."""
    if sys.platform != "linux":
        return
    ports = api_file.ports(context.config)
    active = [name for name in active_firewalls() if name in _FRONT_ENDS]
    for name in active:
        yield note(
            f"the firewall {name} is on",
            "Other computers see this computer's streams only if it allows: UDP "
            f"{ports.discovery}, and UDP and TCP {ports.first} to {ports.last}.",
            BY_FIREWALL[name](every(ports)),
        )
    if not active:
        yield ok("neither ufw nor firewalld is on, as far as systemd knows")
