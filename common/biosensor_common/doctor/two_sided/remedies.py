"""The commands that open the way, written for the computer on which they are to be typed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from biosensor_common import system_programs as programs
from biosensor_common.doctor import firewall as firewall_rules
from biosensor_common.doctor.firewall import Way
from biosensor_common.doctor.report import printable
from biosensor_common.doctor.two_sided.facts import FIREWALLS, NODE, Computer, End
from biosensor_common.lsl_config import DEFAULT_PORT_RANGE, LSL_BASE_PORT
from biosensor_common.terminal import shortened

ANSWER_PORT = LSL_BASE_PORT + DEFAULT_PORT_RANGE - 1
"""At which a computer answers: the last of LSL's ports, so that it needs no other rule."""
HERE = "this computer"
_NAME_WIDTH = 24


@dataclass(frozen=True, slots=True)
class Party:
    """One of the two as sentences name it.

    Attributes
    ----------
    name
        Its host name, or "this computer".
    on
        Where a command is to be typed: "on robot", or "here".
    """

    end: End
    name: str
    on: str

    @property
    def computer(self) -> Computer:
        """What it says of itself."""
        return self.end.computer


def parties(here: End, there: End) -> tuple[Party, Party]:
    """Name both."""
    name = shortened(printable(there.computer.name), _NAME_WIDTH)
    if not name or there.computer.name == here.computer.name:
        name = "the other computer"
    return Party(here, HERE, "here"), Party(there, name, f"on {name}")


def listed(ways: Sequence[Way]) -> str:
    """Return ports as a sentence has them: ``UDP 16571, 16572 to 16827 and TCP 5 to 9``."""
    parts: list[str] = []
    for protocol, several in groupby(ways, key=lambda each: each.protocol):
        parts.append(f"{protocol.upper()} {', '.join(each.range(' to ') for each in several)}")
    return " and ".join(parts)


def to_open(party: Party, other: str, ways: Sequence[Way]) -> str:
    """Return what opens ports of one computer, one command a line.

    Parameters
    ----------
    party
        Whose ports.
    other
        Address of the computer that is to be let in.
    """
    computer = party.computer
    who = firewall_rules.NEIGHBOURS if computer.is_near else other
    return f"{party.on}, {_opening(ways, computer.system, computer.firewalls, who)}"


def local_opening(ways: Sequence[Way]) -> str:
    """Return what opens ports of this computer to its neighbours."""
    return _opening(ways, sys.platform, active_firewalls(), firewall_rules.NEIGHBOURS)


def active_firewalls() -> tuple[str, ...]:
    """Return which of `FIREWALLS` are on here, as far as systemd knows."""
    if sys.platform != "linux":
        return ()
    return tuple(e for e in FIREWALLS if programs.succeeds("systemctl", "is-active", e))


def port_option(port: int) -> str:
    """Return the option that names a port, with a blank before it; none for the usual one."""
    return "" if port == ANSWER_PORT else f" --port {port}"


def _opening(ways: Sequence[Way], system: str, firewalls: Sequence[str], who: str) -> str:
    if system == "win32":
        return (
            f"as administrator: {firewall_rules.netsh(ways, who)}\n"
            "a rule that blocks wins over these; it is named by: biosensor-gateway doctor --only "
            "windows_firewall"
        )
    if system == "darwin":
        return firewall_rules.MAC
    if system == "linux":
        return "\n".join(_linux(ways, firewalls))
    return f"have its firewall let in {listed(ways)}"


def to_ask_directly(party: Party, address: str) -> str:
    """Return what has the LSL programs of a computer ask another one without multicast."""
    if party.computer.program == NODE:
        return (
            f"{party.on}, start the node with: ros2 launch lsl_to_ros lsl_to_ros.launch.py "
            f'known_peers:="[{address}]"'
        )
    return (
        f"{party.on}: biosensor-gateway config lsl --for two-pc --peer {address}\n"
        "and start LabRecorder there again (this writes KnownPeers into lsl_api.cfg)"
    )


def doctor_command(program: str) -> str:
    """Return how doctor is started on the computer of a program."""
    return "python3 -m lsl_to_ros.doctor" if program == NODE else "biosensor-gateway doctor"


def _linux(ways: Sequence[Way], firewalls: Sequence[str]) -> list[str]:
    commands = {
        "ufw": firewall_rules.ufw(ways),
        "firewalld": firewall_rules.firewalld(ways),
        "nftables": firewall_rules.nftables(ways),
    }
    # ufw and firewalld are made of nftables themselves.
    chosen = [name for name in ("ufw", "firewalld") if name in firewalls] or list(firewalls)
    return [f"with {name}: {commands[name]}" for name in chosen or commands]
