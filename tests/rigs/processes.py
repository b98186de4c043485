"""What tests know of processes and do to them: who outlives a test, signals, priority, memory."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import FrameType

import psutil

# Some programs are meant to outlive who starts them: an agent that a page has started, the
# supervisor of a recording. A test that fails, or ends while such a program is only about to take
# its lock, leaves it behind; it then runs beside all later tests, and for days.
GRACE_S = 5.0
"""For one that is ending already."""
OF_A_RUN, OF_A_FOLDER = "LSLAPICFG", "BIOSENSOR_GATEWAY_STATE"
"""Variables that all programs inherit: of this run of tests, and of one test."""


def outliving(variable: str, value: str | Path) -> list[psutil.Process]:
    """Return programs that have this in their environment, and have left the tree of this one."""
    if sys.platform == "win32":
        return []
    mine = psutil.Process()
    known = {os.getpid(), *(each.pid for each in [*mine.parents(), *mine.children(recursive=True)])}
    return [
        each
        for each in psutil.process_iter()
        if each.pid not in known and _environment(each).get(variable) == str(value)
    ]


def end_all(found: Iterable[psutil.Process], grace_s: float = GRACE_S) -> list[str]:
    """End programs; say which of them did not end by themselves, and of which tests they are."""
    _, alive = psutil.wait_procs(list(found), timeout=grace_s)
    said = [f"{' '.join(_command(each))[-160:]} (of {_test(each)})" for each in alive]
    for each in alive:
        _tell(each, kill=False)
    _, deaf = psutil.wait_procs(alive, timeout=GRACE_S)
    for each in deaf:
        _tell(each, kill=True)
    return said


def _tell(process: psutil.Process, *, kill: bool) -> None:
    with suppress(psutil.NoSuchProcess):
        process.kill() if kill else process.terminate()


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return ["?"]


def _test(process: psutil.Process) -> str:
    return _environment(process).get("PYTEST_CURRENT_TEST", "no test")


def _environment(process: psutil.Process) -> dict[str, str]:
    try:
        return process.environ()
    except (psutil.Error, OSError):
        return {}


def let_programs_be_interrupted() -> None:
    """Give programs that tests start the default reaction to signals that this run ignores.

    ``nohup`` has SIGHUP ignored and a shell without job control SIGINT, and an ignored signal is
    inherited, also through ``exec``, so that a program cannot be asked to end by it. A handled one
    is back at its default after ``exec``; and as the handler does nothing, the run itself goes on
    as it was meant to, its workers included.
    """
    for name in ("SIGHUP", "SIGINT", "SIGQUIT"):
        number = getattr(signal, name, None)
        if number is None:
            continue
        # Workers start with what the main process passes on, which is the default.
        worker = name == "SIGHUP" and "PYTEST_XDIST_WORKER" in os.environ
        if worker or signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _go_on)


def _go_on(_number: int, _frame: FrameType | None) -> None:
    pass


_PRIORITY = -10


def before_others(process: int = 0) -> None:
    """Let a process run before the others, where the system allows that (root).

    A sensor measures and a wire carries whatever the computers beside them do. Only so does a
    test that blames the product for what is late or lost not blame it for a busy machine.

    Parameters
    ----------
    process
        Its id; the caller's own by default. Threads and programs that it starts later inherit it.
    """
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process, _PRIORITY)


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


# Where one begins, glibc's arena.c has memory of this size and alignment (64-bit systems).
_HEAP_BYTES = 64 * 1024 * 1024


def count_arenas(pid: int) -> int:
    """Return how many arenas a process has, the main one included.

    An arena that has outgrown 64 MB counts again for each further 64 MB.
    """
    maps = [line.split() for line in Path(f"/proc/{pid}/maps").read_text().splitlines()]
    # What is not used yet of a heap follows it, without any permission.
    return 1 + sum(_is_heap(used, unused) for used, unused in pairwise(maps))


def _is_heap(used: list[str], unused: list[str]) -> bool:
    if used[1] != "rw-p" or unused[1] != "---p" or len(used) > 5 or len(unused) > 5:
        return False
    begin, end = (int(part, 16) for part in used[0].split("-"))
    next_begin, next_end = (int(part, 16) for part in unused[0].split("-"))
    is_whole = end == next_begin and next_end - begin == _HEAP_BYTES
    return is_whole and begin % _HEAP_BYTES == 0
