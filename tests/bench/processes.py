"""Child processes in a network of their own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import uuid
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, Queue
from typing import Self

_PATIENCE_S = 30.0
_LSL_CONFIG = """\
[lab]
SessionID = bench-{session}
KnownPeers = {{127.0.0.1}}
[multicast]
ResolveScope = machine
[ports]
PortRange = 256
[log]
level = -2
"""


class BenchError(Exception):
    """A process of the benchmark did not do its part."""


def isolated_environment(folder: Path) -> dict[str, str]:
    """Return an environment whose LSL session and ROS domain nobody else is in."""
    config = folder / "lsl_api.cfg"
    config.write_text(_LSL_CONFIG.format(session=uuid.uuid4().hex))
    return {
        **os.environ,
        "LSLAPICFG": str(config),
        "ROS_DOMAIN_ID": str(random.randint(1, 100)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


class Process:
    """One child that talks by lines; killed at the end of its ``with`` block."""

    def __init__(self, arguments: list[str], environment: dict[str, str], log: Path) -> None:
        self._name = " ".join(arguments[:2])
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

    @property
    def cpu_s(self) -> float:
        """CPU time of all its threads so far, user and system."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def memory_mb(self) -> float:
        """Resident memory in MB (1e6 bytes)."""
        pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def line(self, patience_s: float = _PATIENCE_S) -> str:
        """Return the next line that it says; empty if none comes."""
        try:
            return self._lines.get(timeout=patience_s)
        except Empty:
            return ""

    def expect(self, word: str, patience_s: float = _PATIENCE_S) -> None:
        """Wait until it says that word.

        Raises
        ------
        BenchError
            If it says something else, nothing, or ends.
        """
        said = self.line(patience_s)
        if said != word:
            raise self._failure(f"said {said!r} instead of {word!r}")

    def tell(self) -> None:
        """Let it go on."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")

    def interrupt(self) -> None:
        """Send SIGINT."""
        self._process.send_signal(signal.SIGINT)

    def wait(self) -> None:
        """Let it end.

        Raises
        ------
        BenchError
            If it does not, or not with exit code 0.
        """
        assert self._process.stdin is not None
        self._process.stdin.close()
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


class Processes:
    """Starts children with one environment; all end with the ``with`` block.

    Attributes
    ----------
    environment
        What the next children get.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = isolated_environment(folder)
        self._stack = ExitStack()
        self._started = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start(self, *arguments: str) -> Process:
        """Start ``python -m`` with these arguments."""
        self._started += 1
        log = self.folder / f"{self._started}.log"
        return self._stack.enter_context(Process(list(arguments), self.environment, log))
