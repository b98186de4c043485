"""Child processes in a network of their own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
import uuid
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, Queue
from typing import Self

_PATIENCE_S = 30.0
# An outlet takes two ports of TCP and two of UDP, so 100 would not find enough of them
# between those of other sessions on this machine. One beyond the range is not found.
PORT_RANGE = 256
_PORTS_PER_OUTLET = 4
_FIRST_PORT, _LAST_PORT = 20_000, 32_000
_LSL_CONFIG = """\
[lab]
SessionID = bench-{session}
KnownPeers = {{127.0.0.1}}
[multicast]
ResolveScope = machine
[ports]
BasePort = {base_port}
PortRange = {port_range}
[log]
level = -2
"""


class BenchError(Exception):
    """A process of the benchmark did not do its part."""


def ports_for(outlets: int) -> int:
    """Return a range of ports in which so many outlets find theirs."""
    return max(PORT_RANGE, _PORTS_PER_OUTLET * outlets)


def isolated_environment(folder: Path, port_range: int = PORT_RANGE) -> dict[str, str]:
    """Return an environment whose LSL session and ROS domain nobody else is in.

    Parameters
    ----------
    port_range
        Ports of LSL; `ports_for` tells how many are enough.
    """
    config = folder / "lsl_api.cfg"
    base_port = random.choice(range(_FIRST_PORT, _LAST_PORT, port_range))
    ports = {"base_port": base_port, "port_range": port_range}
    config.write_text(_LSL_CONFIG.format(session=uuid.uuid4().hex, **ports))
    return {
        **os.environ,
        "LSLAPICFG": str(config),
        "ROS_DOMAIN_ID": str(random.randint(1, 100)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


class Usage:
    """What a running process takes."""

    def __init__(self, pid: int) -> None:
        self._folder = Path("/proc", str(pid))

    @property
    def cpu_s(self) -> float:
        """CPU time of all its threads so far, user and system."""
        fields = (self._folder / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def memory_mb(self) -> float:
        """Resident memory in MB (1e6 bytes)."""
        pages = int((self._folder / "statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    @property
    def threads(self) -> int:
        """Threads that it has now."""
        return sum(1 for _ in (self._folder / "task").iterdir())

    @property
    def descriptors(self) -> int:
        """File descriptors that it has open now."""
        return sum(1 for _ in (self._folder / "fd").iterdir())


class Process(Usage):
    """One child that talks by lines; killed at the end of its ``with`` block."""

    def __init__(self, arguments: list[str], environment: dict[str, str], log: Path) -> None:
        self._name = " ".join(arguments)[:80]
        self._log = log
        with log.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                bufsize=0,
            )
        super().__init__(self._process.pid)
        self._lines: Queue[str] = Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def line(self, patience_s: float = _PATIENCE_S) -> str:
        """Return the next line that it says; empty if none comes."""
        try:
            return self._lines.get(timeout=patience_s)
        except Empty:
            return ""

    def expect(self, word: str, patience_s: float = _PATIENCE_S) -> list[str]:
        """Wait until it says that word; return what else is in the line.

        Raises
        ------
        BenchError
            If it says something else, nothing, or ends.
        """
        said = self.line(patience_s)
        first, *more = said.split() or [""]
        if first != word:
            raise self._failure(f"said {said!r} instead of {word!r}")
        return more

    def tell(self, order: str = "") -> None:
        """Give it an order; an empty one lets it go on."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{order}\n".encode())

    def stop(self) -> None:
        """End it by SIGINT.

        Raises
        ------
        BenchError
            If it does not end, or not with exit code 0.
        """
        self._process.send_signal(signal.SIGINT)
        self.wait()

    def pause(self) -> None:
        """Send SIGSTOP."""
        self._process.send_signal(signal.SIGSTOP)

    def kill(self) -> None:
        """Send SIGKILL, and see it dead."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Tell it to finish, by closing the pipe."""
        assert self._process.stdin is not None
        self._process.stdin.close()

    def wait(self) -> None:
        """Let it finish.

        Raises
        ------
        BenchError
            If it does not, or not with exit code 0.
        """
        self.close()
        try:
            code = self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired as error:
            raise self._failure("did not end") from error
        if code:
            raise self._failure(f"ended with code {code}")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line.decode().strip())
        self._lines.put("the end")

    def _failure(self, what: str) -> BenchError:
        tail = self._log.read_text(errors="replace")[-2000:]
        return BenchError(f"{self._name} {what}\n{tail}")


class CpuMeter:
    """CPU of one process between two moments, in percent of one core."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._begin_s, self._begin_cpu_s = time.monotonic(), process.cpu_s

    def percent(self) -> float:
        """Return the share since this meter was made."""
        cpu_s = self._process.cpu_s - self._begin_cpu_s
        return 100 * cpu_s / (time.monotonic() - self._begin_s)


class Processes:
    """Starts children with one environment; all end with the ``with`` block."""

    def __init__(self, folder: Path, port_range: int = PORT_RANGE) -> None:
        self.folder = folder
        self.environment = isolated_environment(folder, port_range)  # What the next children get.
        self._stack = ExitStack()
        self._started = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start_node(self, *arguments: str) -> Process:
        """Start ``lsl_to_ros``; :meth:`Process.stop` ends it."""
        return self.start("lsl_to_ros.node", *arguments)

    def start(self, *arguments: str) -> Process:
        """Start ``python -m`` with these arguments."""
        self._started += 1
        log = self.folder / f"{self._started}.log"
        return self._stack.enter_context(Process(list(arguments), self.environment, log))
