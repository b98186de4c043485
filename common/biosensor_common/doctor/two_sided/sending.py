"""Sends to the open ports of the other computer, in each way that LSL does."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from biosensor_common.doctor.two_sided.open_ports import GROUPS, Targets

CONNECT_S = 2.0
"""So long a connection is waited for; who drops packets lets it wait for ever."""
_ROUNDS, _PAUSE_S = 4, 0.15
_THREADS = 64
_BROADCAST = "255.255.255.255"


def send(targets: Targets, own: str, other: str, adapters: Sequence[str], mark: bytes) -> None:
    """Send packets and open connections.

    Parameters
    ----------
    targets
        The other's ports.
    own, other
        Addresses of the two computers.
    adapters
        All addresses of this one; LSL sends its questions by each. Empty for no multicast.
    mark
        With what each packet begins.
    """
    # A packet may be lost on any network; of several, one comes.
    for _ in range(_ROUNDS):
        with _socket(own) as sender:
            for port in (*targets.udp, *((targets.discovery,) if targets.discovery else ())):
                _to(sender, mark, other, port)
        if targets.discovery:
            for adapter in adapters:
                _multicast(adapter, targets.discovery, mark)
        time.sleep(_PAUSE_S)
    open_ports(other, targets.tcp, own)


def open_ports(other: str, ports: Iterable[int], own: str = "") -> set[int]:
    """Connect to ports of the other computer, close at once, and return those that are open.

    Parameters
    ----------
    other
        Its address.
    own
        Address of this computer to do it from; empty for the system's choice.
    """
    several = list(dict.fromkeys(ports))
    with ThreadPoolExecutor(_THREADS) as pool:
        found = pool.map(partial(_opens, own, other), several)
        return {port for port, is_open in zip(several, found, strict=True) if is_open}


def _opens(own: str, other: str, port: int) -> bool:
    try:
        socket.create_connection((other, port), CONNECT_S, (own, 0)).close()
    except OSError:
        return False
    return True


def _multicast(adapter: str, port: int, mark: bytes) -> None:
    with contextlib.suppress(OSError), _socket(adapter) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        _to(sender, mark, _BROADCAST, port)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(adapter))
        # As far as LSL's scope "site" goes.
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 24)
        for group in GROUPS:
            _to(sender, mark, group, port)


def _socket(address: str) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with contextlib.suppress(OSError):
        sender.bind((address, 0))
    return sender


def _to(sender: socket.socket, packet: bytes, address: str, port: int) -> None:
    # What cannot leave does not arrive, which is what is asked.
    with contextlib.suppress(OSError):
        sender.sendto(packet, (address, port))
