"""Checks the network adapters, the route of LSL's multicast, and LSL's ports."""

from __future__ import annotations

import re
import socket
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from ipaddress import ip_address

from biosensor_common.doctor.check import Context, Finding, Guide, error, note, ok, warning
from biosensor_common.doctor.probe import probe_command
from biosensor_common.errors import ConfigError
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import DEFAULT_PORT_RANGE, LOOPBACK, LslApiFile, Ports

LSL_GROUP = "239.255.172.215"
"""The group of LSL's scope "site"."""
_VIRTUAL = re.compile(
    r"docker|br-|veth|virbr|vmnet|vboxnet|podman|cni|lxc|lxd|tun\d|tap\d|utun|ppp|wg\d|zt|"
    r"tailscale|.*(vethernet|wsl|hyper-v|vmware|virtualbox|vpn|wireguard|zerotier|tap-windows)",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Interface:
    """One network adapter that is up, and its IPv4 addresses."""

    name: str
    addresses: tuple[str, ...]
    has_multicast: bool
    """False only if the system reports that it has no multicast."""

    @property
    def is_loopback(self) -> bool:
        """Whether it reaches this computer only."""
        return all(ip_address(each).is_loopback for each in self.addresses)

    @property
    def is_virtual(self) -> bool:
        """Whether its name is typical of containers, virtual machines or VPNs."""
        return _VIRTUAL.match(self.name) is not None

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(self.addresses)})"


PORTS_A_STREAM = 2
"""Ports per stream, for TCP and for UDP: one for IPv4, one for IPv6."""
_KINDS = {"TCP": socket.SOCK_STREAM, "UDP": socket.SOCK_DGRAM}
_UNKNOWN = "another user's program"


def interfaces(context: Context) -> Iterator[Finding]:
    """List the adapters and check whether LSL can use them."""
    every = adapters()
    network = [each for each in every if not each.is_loopback]
    if not network:
        yield _only_loopback(context)
        return
    real = [each for each in network if not each.is_virtual]
    guide = context.guide
    yield from (_adapter(each, guide) for each in real)
    yield from _virtual([each for each in network if each.is_virtual], guide)
    yield from _route(network, route(), guide)
    if len(real) > 1:
        yield note(
            f"{len(real)} networks: {', '.join(str(each) for each in real)}",
            "Streams on each of them are found, but a computer on two of them may be reached "
            "through the slower one, such as Wi-Fi.",
            "disconnect the networks that the recording does not need",
        )


def adapters() -> list[Interface]:
    """Return the adapters that are up and have an IPv4 address."""
    import psutil

    states = psutil.net_if_stats()
    found: list[Interface] = []
    for name, entries in psutil.net_if_addrs().items():
        addresses = tuple(each.address for each in entries if each.family == socket.AF_INET)
        state = states.get(name)
        if state is not None and state.isup and addresses:
            # Windows reports no flags; there every adapter has multicast.
            has_multicast = not state.flags or "multicast" in state.flags.split(",")
            found.append(Interface(name, addresses, has_multicast))
    return found


def route() -> str:
    """Return this computer's address on the route to LSL's multicast group; empty if none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Connecting a UDP socket selects a route and sends nothing.
            probe.connect((LSL_GROUP, 16571))
        except OSError:
            return ""
        address: str = probe.getsockname()[0]
        return address


def _only_loopback(context: Context) -> Finding:
    if _asks_itself(context):
        return ok("no network is up; LSL programs on this computer ask it directly (KnownPeers)")
    return warning(
        "no network is up, only the loopback",
        "LabRecorder (liblsl 1.17) on this computer then sees only one, arbitrary stream.",
        f"{context.guide.ask_itself}\nand restart LabRecorder; or connect this computer to any "
        "network",
    )


def _asks_itself(context: Context) -> bool:
    """Whether the user's file already has the setting that the guide asks for."""
    file = context.lsl_file
    if file is None:
        return False
    try:
        own = LslApiFile(file.read_bytes().decode("utf-8", "replace"), str(file))
    except (OSError, ConfigError):
        # The check lsl_config reports the error.
        return False
    ports = api_file.ports(context.config)
    return LOOPBACK in own.known_peers and own.ports.last >= ports.last


def _adapter(interface: Interface, guide: Guide) -> Finding:
    if not interface.has_multicast:
        return warning(
            f"{interface} is up, but has no multicast",
            "LSL programs beyond it do not find this computer's streams, nor this computer theirs.",
            f"sudo ip link set {interface.name} multicast on\nor "
            + guide.ask_others.format(peer=interface.addresses[0]),
        )
    return ok(f"{interface} is up")


def _virtual(found: list[Interface], guide: Guide) -> Iterator[Finding]:
    if found:
        yield note(
            f"virtual adapters: {', '.join(str(each) for each in found)}",
            "Containers, virtual machines and VPNs have networks of their own. Windows may send "
            "LSL's queries only there.",
            "if streams of other computers are missing, switch these adapters off for the "
            "recording or, " + guide.ask_others.format(peer="ADDRESS"),
        )


def _route(network: list[Interface], address: str, guide: Guide) -> Iterator[Finding]:
    """Check the preferred multicast route; LSL before 1.16 uses only that one."""
    way = next((each for each in network if address in each.addresses), None)
    old = "LSL programs older than 1.16 ask only there; newer ones ask through every adapter."
    if way is not None and not way.is_virtual:
        yield ok(f"multicast leaves through {way} first")
    elif way is not None:
        yield note(
            f"multicast leaves through the virtual adapter {way} first",
            f"No other computer of the lab is there. {old}",
            f"switch {way.name} off, or give the lab's adapter the lower metric; or "
            + guide.ask_others.format(peer="ADDRESS"),
        )
    else:
        adapter = next((each for each in network if not each.is_virtual), network[0])
        yield note(
            "the system has no preferred route for multicast"
            + (f" but {address}" if address else ": it has no default route"),
            f"That is usual where two computers share a cable. {old}",
            f"for older programs: {_add_route(adapter)}",
        )


def _add_route(adapter: Interface) -> str:
    if sys.platform == "win32":
        return f"as administrator: route add 224.0.0.0 mask 240.0.0.0 {adapter.addresses[0]}"
    if sys.platform == "darwin":
        return f"sudo route -n add -net 224.0.0.0/4 -interface {adapter.name}"
    return f"sudo ip route add 224.0.0.0/4 dev {adapter.name}"


def ports(context: Context) -> Iterator[Finding]:
    """Check that LSL's ports are free, by binding each of them briefly."""
    used = api_file.ports(context.config)
    yield _discovery(used.discovery)
    needed = PORTS_A_STREAM * context.streams_to_open
    for kind in _KINDS:
        yield _range(kind, used, needed, context.guide.edit)


def _discovery(port: int) -> Finding:
    if is_free(_KINDS["UDP"], port, shared=True):
        return ok(f"UDP {port} (discovery) is available")
    holder = _program(_owners("UDP", [port]).get(port))
    return error(
        f"UDP {port} is held exclusively by {holder}",
        "LSL programs answer there; without it, this computer's streams are not found.",
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
    what += f"; the streams in the settings need {needed}"
    why = "The others get ports that firewalls block and that other programs do not ask."
    if len(numbers) >= needed:
        who = _who_command(kind, min(held))
        return error(
            what, why, f"end programs that you do not need; to see which one uses a port: {who}"
        )
    more = max(DEFAULT_PORT_RANGE, 2 * needed)
    fix = f"set port_range = {more} below [lsl]: {edit}"
    return warning(what, why, fix)


def is_free(kind: socket.SocketKind, port: int, *, shared: bool = False) -> bool:
    """Whether a port is free on this computer, independent of firewalls."""
    with socket.socket(socket.AF_INET, kind) as attempt:
        # On POSIX the option only skips ended connections that still occupy the port; on
        # Windows it would take the port away from its owner.
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
    """Return which program holds which port; ports of the other checks count as free."""
    held = [port for port in ports if not is_free(_KINDS[kind], port)]
    owners = _owners(kind, held)
    probes = _probes()
    # A port without an owner may have been freed meanwhile.
    return {
        port: _program(owners.get(port))
        for port in held
        if owners.get(port) not in probes and (port in owners or not is_free(_KINDS[kind], port))
    }


def _owners(kind: str, ports: Sequence[int]) -> dict[int, int | None]:
    """Return the processes that hold ports; None for one that this user may not see."""
    import psutil

    wanted, owners = set(ports), dict[int, int | None]()
    if not wanted:
        return owners
    try:
        connections = psutil.net_connections(kind.lower())
    except psutil.Error:
        # macOS shows them to the administrator only.
        return owners
    for each in connections:
        if each.laddr and each.laddr[1] in wanted:
            port: int = each.laddr[1]
            owners[port] = owners.get(port) or each.pid
    return owners


def _probes() -> set[int]:
    """Return the processes in which other checks are using LSL now."""
    import psutil

    marks, found = probe_command()[1:], set[int]()
    for child in psutil.Process().children(recursive=True):
        try:
            if child.cmdline()[1:] == marks:
                found.add(child.pid)
        except psutil.Error:
            # The process has ended meanwhile.
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
            f'netstat -ano -p {kind} | findstr ":{port}"\nand, for ports that Windows reserves: '
            f"netsh int ipv4 show excludedportrange protocol={kind.lower()}"
        )
    if sys.platform == "darwin":
        return f"sudo lsof -nP -i{kind}:{port}"
    return f"sudo ss -ap --{kind.lower()} 'sport = :{port}'"
