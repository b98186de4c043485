"""A sender that hangs holds up no stream but its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import psutil
import pylsl
import pytest

from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.live import Live
from biosensor_gateway.features.sources import Source

DEADLINE_S = 20.0
SENDER = """
import sys, time
import pylsl
info = pylsl.StreamInfo("held", "ECG", 1, 130.0, "float32", "held")
outlet = pylsl.StreamOutlet(info)
print("up", flush=True)
time.sleep(600)
"""

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="stops a process by a signal"),
]


class Noted:
    def __init__(self) -> None:
        self.names: list[str] = []

    def found(self, source: Source) -> None:
        self.names.append(source.name)

    def refused(self, sentence: str) -> None:
        raise AssertionError(sentence)


@pytest.mark.seam
def test_another_stream_is_taken_while_one_does_not_say_what_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_module, "SETTLED_S", 0.0)
    # Longer than the test: who waits for it fails.
    monkeypatch.setattr(live_module, "_DESCRIPTION_S", 3 * DEADLINE_S)
    info = pylsl.StreamInfo("own", "ECG", 1, 130.0, "float32", "own")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "ECG")
    channel.append_child_value("unit", "microvolts")
    outlet = pylsl.StreamOutlet(info)
    with subprocess.Popen([sys.executable, "-c", SENDER], stdout=subprocess.PIPE) as sender:
        try:
            assert sender.stdout is not None
            assert sender.stdout.readline() == b"up\n"
            both = [*_resolved("held"), *_resolved("own")]
            os.kill(sender.pid, signal.SIGSTOP)
            # One of its threads may still be at work, and answer.
            while psutil.Process(sender.pid).status() != psutil.STATUS_STOPPED:
                time.sleep(0.01)
            noted = Noted()
            live = Live(noted)
            end = time.monotonic() + DEADLINE_S
            while not noted.names:
                live.look(both)
                live.read()
                assert time.monotonic() < end, "the other one was waited for"
                time.sleep(0.05)
        finally:
            sender.kill()
    assert noted.names == ["own"]
    del outlet


def _resolved(source_id: str) -> list[pylsl.StreamInfo]:
    found = pylsl.resolve_byprop("source_id", source_id, 1, DEADLINE_S)
    assert found, source_id
    return found[:1]
