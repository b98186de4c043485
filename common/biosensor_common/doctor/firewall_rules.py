"""Builds the commands that let LSL through the firewall of this system."""

from __future__ import annotations

import sys

from biosensor_common.doctor.lsl_api_file import Ports

WINDOWS_RULE = "Biosensor Gateway"
"""Name of the rule that the installer can add."""


def opening(ports: Ports) -> str:
    """Return what opens the ports on this system, one command a line."""
    if sys.platform == "win32":
        return windows(ports)
    if sys.platform == "darwin":
        return "System Settings > Network > Firewall > Options: allow incoming connections"
    return f"with ufw: {ufw(ports)}\nwith firewalld: {firewalld(ports)}"


def ufw(ports: Ports) -> str:
    """Return the command for ufw."""
    several = f"{ports.first}:{ports.last}"
    return (
        f"sudo ufw allow {ports.discovery}/udp && sudo ufw allow {several}/udp "
        f"&& sudo ufw allow {several}/tcp"
    )


def firewalld(ports: Ports) -> str:
    """Return the command for firewalld."""
    several = f"{ports.first}-{ports.last}"
    return (
        f"sudo firewall-cmd --permanent --add-port={ports.discovery}/udp "
        f"--add-port={several}/udp --add-port={several}/tcp && sudo firewall-cmd --reload"
    )


def windows(ports: Ports) -> str:
    """Return the command for Windows, for a Command Prompt that is run as administrator.

    The installed program is allowed as such, as its installer does; from source, Python
    would be, so that the ports are opened instead.
    """
    add = f'netsh advfirewall firewall add rule name="{WINDOWS_RULE}" dir=in action=allow'
    where = "remoteip=LocalSubnet profile=private,domain"
    if getattr(sys, "frozen", False):
        return f'as administrator: {add} program="{sys.executable}" {where}'
    several = f"{ports.first}-{ports.last}"
    return (
        f"as administrator: {add} protocol=UDP localport={ports.discovery},{several} {where}\n"
        f"and: {add} protocol=TCP localport={several} {where}"
    )
