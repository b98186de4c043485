"""A stream that ends before it is received holds up no other one, nor the end of the program."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pylsl
import pytest

DEADLINE_S = 60.0
LIVES_S = 1.5
"""Its header is read by then, and it is not received yet: devices settle for 3 s."""

pytestmark = [
    pytest.mark.seam,
    pytest.mark.skipif(sys.platform == "win32", reason="ends a process by a signal"),
]


def _outlet(name: str) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(name, "PPG", 1, 64.0, "float32", name)
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "green")
    channel.append_child_value("unit", "none")
    return pylsl.StreamOutlet(info)


@contextmanager
def _features(said: Path) -> Generator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features"]
    with said.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=output) as it:
        try:
            yield it
        finally:
            it.kill()


def _wait_for(said: Path, text: str) -> None:
    end = time.monotonic() + DEADLINE_S
    while text not in said.read_text("utf-8"):
        assert time.monotonic() < end, f"{text!r} was never said: {said.read_text('utf-8')}"
        time.sleep(0.05)


def test_others_go_on_and_a_signal_ends_it(tmp_path: Path) -> None:
    said = tmp_path / "said.txt"
    with _features(said) as program:
        _wait_for(said, "looking for raw streams")
        stays = _outlet("first")
        _wait_for(said, "first: ")
        for count in range(2):
            goes = _outlet(f"goes-{count}")
            time.sleep(LIVES_S)
            del goes
        later = _outlet("later")
        _wait_for(said, "later: ")
        comes_back = _outlet("goes-1")
        _wait_for(said, "goes-1: ")
        program.send_signal(signal.SIGTERM)
        assert program.wait(DEADLINE_S) == 0
        del stays, later, comes_back
