"""Streams that deliver, and a recording of this computer that ends with its test."""

from __future__ import annotations

import socket
import threading
from collections.abc import Generator
from pathlib import Path
from typing import Self
from unittest.mock import patch

import pylsl
import pytest

from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import Presence
from biosensor_gateway.recording.recorder.programs import find_programs
from biosensor_gateway.recording.recorder.request import (
    LocalStarted,
    RecordingRequest,
    VisibleStream,
)
from biosensor_gateway.recording.recorder.state import RecorderFolder
from biosensor_gateway.settings.models import GatewaySettings

RATE_HZ = 2000
"""So fast that the recorder's blocks are full in a moment."""


def begin(recording: LocalRecorder, request: RecordingRequest, presence: Presence) -> LocalStarted:
    """Start a recording of these streams, whatever others this computer sees."""
    with patch.object(local, "look", return_value=presence):
        return recording.start(request, GatewaySettings())


class Sources:
    """Streams that deliver until they are taken away. A context manager."""

    def __init__(self, *names: str) -> None:
        self._outlets: dict[str, pylsl.StreamOutlet] = {}
        self._begun: dict[str, float] = {}
        self._pushed: dict[str, int] = {}
        self._lock, self._is_over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._push)
        for name in names:
            self.add(name)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()
        self._outlets.clear()

    def add(self, name: str, rate_hz: int = RATE_HZ) -> None:
        """Let a stream deliver; one without a rate as often as it can."""
        info = pylsl.StreamInfo(name, "EEG", 2, rate_hz, "float32", f"{name}-id")
        with self._lock:
            self._outlets[name] = pylsl.StreamOutlet(info)
            self._begun[name], self._pushed[name] = pylsl.local_clock(), 0

    def remove(self, name: str) -> None:
        with self._lock:
            del self._outlets[name]

    def presence(self, *missing: str) -> Presence:
        host = socket.gethostname()
        seen = tuple(VisibleStream(each, f"{each}-id", host) for each in self._outlets)
        return Presence(seen, (), missing)

    def _push(self) -> None:
        while not self._is_over.wait(0.05):
            with self._lock:
                for name in self._outlets:
                    self._push_what_is_due(name)

    def _push_what_is_due(self, name: str) -> None:
        if not self._outlets[name].get_info().nominal_srate():
            self._outlets[name].push_sample([1.0, float(self._pushed[name] % 7)])
            self._pushed[name] += 1
            return
        begun, first = self._begun[name], self._pushed[name]
        due = int((pylsl.local_clock() - begun) * RATE_HZ)
        # Whoever has no time pushes later, and as many.
        numbers = range(first, due)
        if numbers:
            stamps = [begun + number / RATE_HZ for number in numbers]
            values = [[float(number % 7), float(number % 5)] for number in numbers]
            self._outlets[name].push_chunk(values, stamps)
            self._pushed[name] = due


def only(recorder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let there be one of the two recorders."""
    command = find_programs(Path())[0][recorder]

    def programs(_folder: Path) -> tuple[dict[str, tuple[str, ...]], list[str]]:
        return {recorder: command}, []

    monkeypatch.setattr(local, "find_programs", programs)


@pytest.fixture
def sources() -> Generator[Sources]:
    with Sources("chest", "wrist") as both:
        yield both


@pytest.fixture
def state(tmp_path: Path) -> Generator[Path]:
    """A state folder; what a test leaves running is ended."""
    path = tmp_path / "state"
    yield path
    folder = RecorderFolder(path)
    if folder.is_running:
        folder.ask_to_stop()
    assert folder.wait_until_free(60.0)
