"""Computers on one network: each is a set of namespaces, joined by a switch.

A computer has its own network, host name, shared memory and monotonic clock; so
neither DDS nor LSL can take a way past the network, and the LSL clocks of two
computers are as far apart as those of real ones.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

ROOT = Path(__file__).parents[3]
NETWORK = "10.77.0"
PORT = "eth0"
DEADLINE_S = 30.0
_NAMESPACES = ("--net", "--uts", "--ipc", "--mount", "--time")
# The computer lasts until the pipe to its only process is closed.
_BOOT = """set -e
hostname "$1"
mount -t tmpfs tmpfs /dev/shm
ip link set lo up
echo $$
exec cat
"""
_LOSS = f"""table inet weather {{
    chain arriving {{
        type filter hook input priority 0
        iifname "{PORT}" numgen random mod 100 < %d counter drop
    }}
}}
"""
_NO_MULTICAST = f"""table inet no_multicast {{
    chain arriving {{
        type filter hook input priority 0
        iifname "{PORT}" meta l4proto udp pkttype {{ broadcast, multicast }} counter drop
    }}
}}
"""


class HostsError(Exception):
    """The computers cannot be made, or their network not be disturbed; says why."""


class Host:
    """One computer; a context manager.

    Parameters
    ----------
    name
        Its host name.
    clock_offset_s
        What its monotonic clock is ahead of this machine's, in whole seconds.

    Raises
    ------
    HostsError
        On entering, where namespaces cannot be made.
    """

    def __init__(self, name: str, clock_offset_s: int = 0) -> None:
        self.name = name
        self._offset_s = clock_offset_s
        self._processes = ExitStack()
        self._pid = 0

    def __enter__(self) -> Self:
        offset = ("--monotonic", str(self._offset_s))
        boot = ("sh", "-c", _BOOT, "sh", self.name)
        try:
            process = subprocess.Popen(
                ["unshare", *_NAMESPACES, *offset, "--fork", "--kill-child", *boot],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        except OSError as error:
            raise _impossible(str(error)) from error
        self._processes.callback(_shut_down, process)
        assert process.stdout is not None
        said = process.stdout.readline().strip()
        if not said.isdigit():
            self._processes.close()
            raise _impossible(said)
        self._pid = int(said)
        return self

    def __exit__(self, *_: object) -> None:
        self._processes.close()

    @property
    def pid(self) -> int:
        """Process whose namespaces are the computer's."""
        return self._pid

    def command(self, *command: str) -> list[str]:
        """Command line that runs a command on this computer; it does not outlive its parent."""
        # The mount namespace would be entered at its root.
        place = ("--target", str(self._pid), *_NAMESPACES, f"--wd={ROOT}")
        return ["setpriv", "--pdeathsig", "KILL", "nsenter", *place, "--", *command]

    def run(self, *command: str, text: str = "") -> str:
        """Run a command on this computer; return what it said.

        Raises
        ------
        HostsError
            If it failed.
        """
        return _run(self.command(*command), text)


class Lan:
    """Computers joined by a switch; a context manager.

    Parameters
    ----------
    clock_offsets_s
        By name of the computer; in their order they are 10.77.0.1, 10.77.0.2 and so on.
    network
        The first three numbers of the addresses.

    Raises
    ------
    HostsError
        On entering, where namespaces cannot be made.
    """

    def __init__(self, clock_offsets_s: dict[str, int], network: str = NETWORK) -> None:
        self._hosts = {name: Host(name, offset) for name, offset in clock_offsets_s.items()}
        self._addresses = {n: f"{network}.{i}" for i, n in enumerate(self._hosts, start=1)}
        self._network = network
        self._switch = Host("switch")
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            for host in (self._switch, *self._hosts.values()):
                stack.enter_context(host)
            bridge = ("type", "bridge", "mcast_snooping", "0")
            self._switch.run("ip", "link", "add", "lan", *bridge)
            self._switch.run("ip", "link", "set", "lan", "up")
            for number, host in enumerate(self._hosts.values(), start=1):
                self.connect(host, number)
            for host in self._hosts.values():
                _await_carrier(host)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def __getitem__(self, name: str) -> Host:
        return self._hosts[name]

    def __contains__(self, name: str) -> bool:
        return name in self._hosts

    def address(self, name: str) -> str:
        """Return the address of a computer."""
        return self._addresses[name]

    def connect(self, host: Host, number: int, port: str = PORT) -> None:
        """Plug a computer into the switch; *number* is the last of its address."""
        # Its end at the switch has the name of the computer.
        ends = ("type", "veth", "peer", port, "netns", str(host.pid))
        self._switch.run("ip", "link", "add", host.name, *ends)
        self._switch.run("ip", "link", "set", host.name, "master", "lan", "up")
        host.run("ip", "address", "add", f"{self._network}.{number}/24", "dev", port)
        host.run("ip", "link", "set", port, "up")

    def route_by(self, number: int) -> None:
        """Give every computer a gateway to all other networks."""
        for host in self._hosts.values():
            host.run("ip", "route", "add", "default", "via", f"{self._network}.{number}")

    def drop_multicast(self) -> None:
        """Let no computer hear what is sent to several, as some Wi-Fi and managed switches do."""
        for host in self._hosts.values():
            host.run("nft", "-f", "-", text=_NO_MULTICAST)

    def lose(self, percent: int) -> None:
        """Let every computer lose so many of the packets that come in over the network."""
        for host in self._hosts.values():
            host.run("nft", "-f", "-", text=_LOSS % percent)

    def lose_nothing(self) -> dict[str, int]:
        """End the losses; return how many packets each computer has lost."""
        lost: dict[str, int] = {}
        for name, host in self._hosts.items():
            lost[name] = _dropped(host.run("nft", "--json", "list", "table", "inet", "weather"))
            host.run("nft", "delete", "table", "inet", "weather")
        return lost

    def unplug(self, name: str) -> None:
        """Pull a computer's cable out of the switch."""
        self._switch.run("ip", "link", "set", name, "down")

    def plug_in(self, name: str) -> None:
        """Put the cable back."""
        self._switch.run("ip", "link", "set", name, "up")


def _shut_down(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    try:
        process.wait(DEADLINE_S)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _run(command: Sequence[str], text: str) -> str:
    try:
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    except OSError as error:
        raise HostsError(f"{command[0]}: {error.strerror}") from error
    if done.returncode:
        raise HostsError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


def _await_carrier(host: Host) -> None:
    """Wait until the port is up; DDS chooses its interfaces once, when a program starts."""
    end = time.monotonic() + DEADLINE_S
    while True:
        (link,) = json.loads(host.run("ip", "-json", "link", "show", PORT))
        if link["operstate"] == "UP":
            return
        if time.monotonic() > end:
            raise HostsError(f"{host.name}: the port {PORT} is {link['operstate']}")
        time.sleep(0.05)


def _dropped(listing: str) -> int:
    rules = [item["rule"] for item in json.loads(listing)["nftables"] if "rule" in item]
    counters = [part["counter"] for rule in rules for part in rule["expr"] if "counter" in part]
    return sum(counter["packets"] for counter in counters)


def _impossible(reason: str) -> HostsError:
    return HostsError(
        f"two computers cannot be made of namespaces here ({reason}); run this test as root on "
        "Linux 5.6 or later, where unshare may make network, mount, UTS, IPC and time namespaces"
    )
