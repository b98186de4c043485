"""Says of another process whether it stands still, and what waits in its sockets (Linux)."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

_TABLES = ("tcp", "tcp6")


def stands_still(pid: int) -> bool:
    """Return whether each thread of a process is stopped by a signal (proc_pid_stat(5), 3)."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return all((task / "stat").read_text().rpartition(")")[2].split()[0] == "T" for task in tasks)


def waiting_bytes(pid: int) -> list[int]:
    """Return the bytes that have come and were not read, of each TCP socket of a process.

    The tables are those of proc_pid_net(5): the fifth column has the queues, sent and received,
    in hexadecimal digits, the tenth the inode.
    """
    own: set[str] = set()
    for handle in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            own.add(str(handle.readlink()))
    found: list[int] = []
    for table in _TABLES:
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            columns = line.split()
            if f"socket:[{columns[9]}]" in own:
                found.append(int(columns[4].partition(":")[2], 16))
    return found
