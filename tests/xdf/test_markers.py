"""The real LabRecorder records the stream of markers: with markers, and without any."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pylsl
import pytest

from biosensor_common.naming import lsl_name
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.recorder.recording_file import summarize
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report import Measured, Report
from biosensor_gateway.streaming.counters import counters_text
from biosensor_gateway.streaming.markers import MarkerKind, MarkerStream
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs.lab_recorder import LabRecorder
from tests.xdf.checking import codes, load_by_pyxdf

pytestmark = pytest.mark.nightly

AGENT = DeviceIdentity("gateway", socket.gethostname())
NAME = lsl_name(AGENT, "markers")
TICK_S, TICKS = 0.25, 48
SHORT_OF_STOP = 12
"""LabRecorder takes samples in twice a second, and not once more when it stops. It measures the
clock after 5 s for the first time, and a second time in 10 s."""


class Agent:
    """The agent's streams of markers and counters."""

    def __init__(self) -> None:
        self.markers = MarkerStream()
        self.markers.open()
        self._counters = Outlet(declaration("gateway").stream("counters"), AGENT, DeviceInfo())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._count)
        self._thread.start()

    def record(self, path: Path, marks: bool) -> Report:
        with LabRecorder(path, at_least=2):
            for number in range(TICKS):
                self.markers.tick(pylsl.local_clock())
                if marks and 4 <= number < TICKS - SHORT_OF_STOP:
                    self._mark(number)
                self._stop.wait(TICK_S)
        return judge(read_recording(path))

    def _mark(self, number: int) -> None:
        if number % 4 == 0:
            self.markers.undo()
        else:
            at = pylsl.local_clock() - (number % 3) * 10.0
            self.markers.mark(f"m{number}", "", MarkerKind.BUTTON, "", at)

    def end(self) -> None:
        self._stop.set()
        self._thread.join()
        asyncio.run(self.markers.end())

    def _count(self) -> None:
        while not self._stop.wait(1.0):
            text = counters_text(dict(self.markers.counters))
            self._counters.push_text(text, pylsl.local_clock())


@contextmanager
def running() -> Generator[Agent]:
    agent = Agent()
    try:
        yield agent
    finally:
        agent.end()


def recorded(report: Report) -> Measured:
    (stream,) = (each for each in report.streams if each.name == NAME)
    return stream


def test_every_marker_is_recorded_behind_one_that_says_ready(tmp_path: Path) -> None:
    with running() as agent:
        agent.markers.mark("before", "", MarkerKind.BUTTON, "")
        report = agent.record(tmp_path / "study.xdf", marks=True)
    assert report.is_good
    assert not codes(report, Level.ERROR) | codes(report, Level.WARNING)
    found = recorded(report)
    samples = [json.loads(text) for text in texts(tmp_path / "study.xdf")]
    first, *later = samples
    assert (first["kind"], first["id"]) == ("ready", 2)
    assert [each["id"] for each in later] == list(range(3, 3 + TICKS - SHORT_OF_STOP - 4))
    assert {each["kind"] for each in later} == {"button", "undo"}
    assert len(found.stream.clock_offsets) >= 1
    assert found.counters is not None
    assert found.counters.pushed == found.counters.held > 0


def texts(path: Path) -> list[str]:
    (stream,) = (each for each in load_by_pyxdf(path) if each["info"]["name"] == [NAME])
    return [row[0] for row in stream["time_series"]]


@pytest.mark.parametrize("marks_before", [False, True])
def test_a_stream_without_a_marker_is_closed_as_any_other(
    tmp_path: Path, marks_before: bool
) -> None:
    path = tmp_path / "study.xdf"
    with running() as agent:
        # Somebody receives already, so that nobody is told that the stream is ready.
        info = pylsl.resolve_byprop("name", NAME, timeout=30.0)[0]
        reader = pylsl.StreamInlet(info, recover=False)
        reader.open_stream(30.0)
        while not agent.markers.is_received:
            time.sleep(0.01)
        agent.markers.tick(pylsl.local_clock())
        if marks_before:
            agent.markers.mark("before", "", MarkerKind.BUTTON, "")
        report = agent.record(path, marks=False)
        reader.close_stream()
    found = recorded(report)
    assert (found.stream.sample_count, texts(path)) == (0, [])
    assert found.stream.footer is not None
    assert found.stream.footer.sample_count == 0
    assert len(found.stream.clock_offsets) >= 1
    assert summarize(path).is_closed
    assert report.is_good
    assert {each for each in codes(report) if each[1] == NAME} == {("no-samples", NAME)}
    assert not codes(report, Level.ERROR) | codes(report, Level.WARNING)
