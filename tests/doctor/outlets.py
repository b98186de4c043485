"""Outlets of another program, in a session of their own.

    python -m tests.doctor.outlets SESSION SCOPE STREAMS

It pushes into every outlet until its stdin ends.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import pylsl

PERIOD_S = 0.05
DEADLINE_S = 30.0


@dataclass(frozen=True)
class Offered:
    """One stream; its `source_id` is pylsl's own if it is None."""

    name: str
    source_id: str | None
    format: str = "float32"
    clock: str = "lsl"


def arguments(session: str, streams: Sequence[Offered], scope: str = "machine") -> list[str]:
    """Arguments of the Python that offers streams."""
    described = json.dumps([asdict(each) for each in streams])
    return ["-m", "tests.doctor.outlets", session, scope, described]


@contextmanager
def running(command: Sequence[str], environment: Mapping[str, str]) -> Generator[None]:
    """Run a command that offers streams while the context lasts."""
    process = subprocess.Popen(
        command, env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        said = iter(process.stdout)
        assert any(line.strip() == "open" for line in said)
        yield
    finally:
        process.stdin.close()
        process.wait(DEADLINE_S)
        process.stdout.close()


def main() -> None:
    session, scope = sys.argv[1:3]
    streams = [Offered(**each) for each in json.loads(sys.argv[3])]
    pylsl.set_config_content(
        f"[lab]\nSessionID = {session}\n[multicast]\nResolveScope = {scope}\n"
        "[ports]\nPortRange = 256\n[log]\nlevel = -2\n"
    )
    outlets = [
        pylsl.StreamOutlet(pylsl.StreamInfo(each.name, "Test", 1, 0.0, each.format, each.source_id))
        for each in streams
    ]
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    print("open", flush=True)
    while not ended.wait(PERIOD_S):
        for stream, outlet in zip(streams, outlets, strict=True):
            stamp = time.time() if stream.clock == "unix" else pylsl.local_clock()
            outlet.push_sample([1], stamp)


if __name__ == "__main__":
    main()
