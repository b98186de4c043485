"""Checks that the ports of LSL are free, and names who holds them."""

from __future__ import annotations

import socket
import sys
from collections import Counter
from collections.abc import Iterator, Sequence

from biosensor_common.doctor import lsl_text
from biosensor_common.doctor.children import probe_command
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, ok, warning
from biosensor_common.doctor.lsl_api_file import Ports
from biosensor_common.lsl_config import DEFAULT_PORT_RANGE

PORTS_A_STREAM = 2
"""Of TCP and of UDP: one for IPv4, one for IPv6."""
_KINDS = {"TCP": socket.SOCK_STREAM, "UDP": socket.SOCK_DGRAM}
_UNKNOWN = "a program of somebody else"


def examine(context: Context) -> Iterator[Finding]:
    """Try to have each port for an instant."""
    ports = lsl_text.ports(context.config)
    yield _discovery(ports.discovery)
    needed = PORTS_A_STREAM * context.streams_to_open
    for kind in _KINDS:
        yield _range(kind, ports, needed, context.guide.edit)


def _discovery(port: int) -> Finding:
    if _is_free(_KINDS["UDP"], port, shared=True):
        return ok(f"UDP {port} (discovery) can be had")
    holder = _program(_owners("UDP", [port]).get(port))
    return error(
        f"UDP {port} is held by {holder} for itself alone",
        "LSL programs answer there; without it the streams of this computer are not found.",
        "end that program; if you do not know it: " + _who_command("UDP", port),
    )


def _range(kind: str, ports: Ports, needed: int, edit: str) -> Finding:
    numbers = range(ports.first, ports.last + 1)
    held = _held(kind, numbers)
    free = len(numbers) - len(held)
    what = f"{kind} {ports.first} to {ports.last}: {free} of {len(numbers)} ports are free"
    if held:
        what += f"; the others are held by {_named(Counter(held.values()))}"
    if free >= needed:
        return ok(what)
    what += f"; the streams of the settings need {needed}"
    why = "The others get ports that firewalls block and that nobody asks."
    if len(numbers) >= needed:
        who = _who_command(kind, min(held))
        return error(what, why, f"end programs that you do not need; which one has a port: {who}")
    more = max(DEFAULT_PORT_RANGE, 2 * needed)
    fix = f"set port_range = {more} below [lsl]: {edit}"
    return warning(what, why, fix)


def _is_free(kind: socket.SocketKind, port: int, *, shared: bool = False) -> bool:
    with socket.socket(socket.AF_INET, kind) as attempt:
        # Connections that have ended keep a port for a while on POSIX, but from nobody;
        # on Windows the option would take a port away from its owner.
        if shared or (sys.platform != "win32" and kind is socket.SOCK_STREAM):
            attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind(("", port))
            if kind is socket.SOCK_STREAM:
                attempt.listen(1)
        except OSError:
            return False
        return True


def _held(kind: str, ports: Sequence[int]) -> dict[int, str]:
    """Return who holds which of the ports; what the other checks hold for a moment is free."""
    held = [port for port in ports if not _is_free(_KINDS[kind], port)]
    owners = _owners(kind, held)
    probes = _probes()
    # A port without an owner may be free again by now.
    return {
        port: _program(owners.get(port))
        for port in held
        if owners.get(port) not in probes and (port in owners or not _is_free(_KINDS[kind], port))
    }


def _owners(kind: str, ports: Sequence[int]) -> dict[int, int | None]:
    """Return the processes that hold ports, None for one that may not be known."""
    import psutil

    wanted, owners = set(ports), dict[int, int | None]()
    if not wanted:
        return owners
    try:
        connections = psutil.net_connections(kind.lower())
    except psutil.Error:
        # macOS tells the administrator only.
        return owners
    for each in connections:
        if each.laddr and each.laddr[1] in wanted:
            port: int = each.laddr[1]
            owners[port] = owners.get(port) or each.pid
    return owners


def _probes() -> set[int]:
    """Return the processes in which other checks use LSL at this moment."""
    import psutil

    marks, found = probe_command()[1:], set[int]()
    for child in psutil.Process().children(recursive=True):
        try:
            if child.cmdline()[1:] == marks:
                found.add(child.pid)
        except psutil.Error:
            # It has ended.
            continue
    return found


def _program(pid: int | None) -> str:
    import psutil

    if pid is None:
        return _UNKNOWN
    try:
        return f"{psutil.Process(pid).name()} (process {pid})"
    except psutil.Error:
        return f"process {pid}"


def _named(holders: Counter[str]) -> str:
    return ", ".join(
        name if count == 1 else f"{name}: {count}" for name, count in holders.most_common()
    )


def _who_command(kind: str, port: int) -> str:
    if sys.platform == "win32":
        return (
            f'netstat -ano -p {kind} | findstr ":{port}"\nand, for ports that Windows keeps: '
            f"netsh int ipv4 show excludedportrange protocol={kind.lower()}"
        )
    if sys.platform == "darwin":
        return f"sudo lsof -nP -i{kind}:{port}"
    return f"sudo ss -ap --{kind.lower()} 'sport = :{port}'"
