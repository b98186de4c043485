"""Checks the network adapters, and by which one LSL's multicast leaves."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from ipaddress import ip_address

from biosensor_common.doctor import lsl_text
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, note, ok, warning
from biosensor_common.doctor.guide import Guide
from biosensor_common.doctor.lsl_api_file import LOOPBACK, LslApiFile
from biosensor_common.errors import ConfigError

LSL_GROUP = "239.255.172.215"
"""The group of LSL's scope "site"."""
_VIRTUAL = re.compile(
    r"docker|br-|veth|virbr|vmnet|vboxnet|podman|cni|lxc|lxd|tun\d|tap\d|utun|ppp|wg\d|zt|"
    r"tailscale|.*(vethernet|wsl|hyper-v|vmware|virtualbox|vpn|wireguard|zerotier|tap-windows)",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Interface:
    """One network adapter that is up and has an IPv4 address.

    Attributes
    ----------
    addresses
        Its IPv4 addresses.
    has_multicast
        False only if the system says so.
    """

    name: str
    addresses: tuple[str, ...]
    has_multicast: bool

    @property
    def is_loopback(self) -> bool:
        """Whether it leads nowhere but to this computer."""
        return all(ip_address(each).is_loopback for each in self.addresses)

    @property
    def is_virtual(self) -> bool:
        """Whether its name is one of containers, virtual machines or VPNs."""
        return _VIRTUAL.match(self.name) is not None

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(self.addresses)})"


def examine(context: Context) -> Iterator[Finding]:
    """List the adapters and judge what LSL can do with them."""
    every = interfaces()
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
            "Streams of each of them are found, but a computer that is in two of them at once may "
            "be reached by the slower one, Wi-Fi for instance.",
            "disconnect the networks that the recording does not need",
        )


def interfaces() -> list[Interface]:
    """Return the adapters that are up and have an IPv4 address."""
    import psutil

    states = psutil.net_if_stats()
    found: list[Interface] = []
    for name, entries in psutil.net_if_addrs().items():
        addresses = tuple(each.address for each in entries if each.family == socket.AF_INET)
        state = states.get(name)
        if state is not None and state.isup and addresses:
            # Windows has no flags; there every adapter has multicast.
            has_multicast = not state.flags or "multicast" in state.flags.split(",")
            found.append(Interface(name, addresses, has_multicast))
    return found


def route() -> str:
    """Return this computer's address on the way to LSL's multicast group, empty if none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Nothing is sent by this.
            probe.connect((LSL_GROUP, 16571))
        except OSError:
            return ""
        address: str = probe.getsockname()[0]
        return address


def _only_loopback(context: Context) -> Finding:
    if _asks_itself(context):
        return ok("no network is up; LSL programs of this computer ask it directly (KnownPeers)")
    return warning(
        "no network is up, only the loopback",
        "LabRecorder (liblsl 1.17) on this computer then sees one stream of many, whichever.",
        f"{context.guide.ask_itself}\nand restart LabRecorder; or connect this computer to a "
        "network, any will do",
    )


def _asks_itself(context: Context) -> bool:
    """Whether the user's file does what the guide asks for."""
    file = context.lsl_file
    if file is None:
        return False
    try:
        own = LslApiFile(file.read_bytes().decode("utf-8", "replace"), str(file))
    except (OSError, ConfigError):
        # What is wrong with it is another check's.
        return False
    ports = lsl_text.ports(context.config)
    return LOOPBACK in own.known_peers and own.ports.last >= ports.last


def _adapter(interface: Interface, guide: Guide) -> Finding:
    if not interface.has_multicast:
        return warning(
            f"{interface} is up, but has no multicast",
            "LSL programs on the other side of it do not find the streams of this computer, "
            "nor this computer theirs.",
            f"sudo ip link set {interface.name} multicast on\nor "
            + guide.ask_others.format(peer=interface.addresses[0]),
        )
    return ok(f"{interface} is up")


def _virtual(adapters: list[Interface], guide: Guide) -> Iterator[Finding]:
    if adapters:
        yield note(
            f"virtual adapters: {', '.join(str(each) for each in adapters)}",
            "Containers, virtual machines and VPNs have networks of their own. Windows may send "
            "LSL's questions there and nowhere else.",
            "if streams of other computers are missing, switch these adapters off for the "
            "recording or, " + guide.ask_others.format(peer="ADDRESS"),
        )


def _route(network: list[Interface], address: str, guide: Guide) -> Iterator[Finding]:
    """Judge the way that the system prefers; LSL before 1.16 takes that one only."""
    way = next((each for each in network if address in each.addresses), None)
    old = "LSL programs older than 1.16 ask there only; newer ones ask by every adapter."
    if way is not None and not way.is_virtual:
        yield ok(f"multicast goes by {way} first")
    elif way is not None:
        yield note(
            f"multicast goes by the virtual adapter {way} first",
            f"No other computer of the lab is there. {old}",
            f"switch {way.name} off, or give the adapter of the lab the lower metric; or "
            + guide.ask_others.format(peer="ADDRESS"),
        )
    else:
        adapter = next((each for each in network if not each.is_virtual), network[0])
        yield note(
            "the system prefers no way for multicast"
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
