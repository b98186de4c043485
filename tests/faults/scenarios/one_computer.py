"""The programs of `tests.rigs.hosts` on this machine itself, in the network of the test run."""

from __future__ import annotations

import socket
from pathlib import Path

from tests.rigs.hosts.lan import Host, Lan
from tests.rigs.hosts.pair import Places

NAME = socket.gethostname()
PLACES = Places(agent=NAME, node=NAME, subscriber=NAME, receiver=NAME)


class ThisMachine(Host):
    """Needs no namespaces, and so neither root nor a context."""

    def __init__(self) -> None:
        super().__init__(NAME)

    def command(self, *command: str) -> list[str]:
        """Command line that runs a command here."""
        return list(command)


class OneComputer(Lan):
    """A network of this machine alone; its cable cannot be pulled."""

    def __init__(self) -> None:
        super().__init__({})
        self._here = ThisMachine()

    def __getitem__(self, name: str) -> Host:
        return self._here


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process, in MB (1e6 bytes)."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise ProcessLookupError(f"process {pid} has ended")
