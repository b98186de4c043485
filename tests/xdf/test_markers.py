"""The real LabRecorder records markers, and outlets with known faults."""

from __future__ import annotations

import asyncio
import json
import random
import socket
import threading
import time
import uuid
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pylsl
import pytest

from biosensor_common.naming import lsl_name
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.recorder.recording_file import summarize
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report import Measured, Report
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from biosensor_gateway.recording.xdf.verdict import judge
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.marker_stream import MarkerKind, MarkerStream
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs.lab_recorder import LabRecorder
from tests.xdf.checking import codes, load_by_pyxdf, text_of
from tests.xdf.xdf_file import chunk_ends

pytestmark = pytest.mark.nightly

# The real LabRecorder records the stream of markers: with markers, and without any.

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


# The real LabRecorder records outlets with known faults, ours and other programs'.
RECORD_S = 12.5
STREAMS = 9
ECG_HZ, GAP_SAMPLES, STEP_S = 130, 260, 0.1
INVENTED = 7
# About four seconds of all streams.
ENOUGH_BYTES = 25_000
STREAM = uuid.uuid4().hex[:8]
STRAP = DeviceIdentity("polar_h10", STREAM)
OURS = DeviceIdentity("gateway", STREAM)


def _foreign(
    name: str, channel_format: str, rate: float, source_id: str | None = None, channels: int = 1
) -> pylsl.StreamOutlet:
    name = f"{name}-{STREAM}"
    info = pylsl.StreamInfo(name, "Test", channels, rate, channel_format, source_id or name)
    return pylsl.StreamOutlet(info)


class Outlets:
    """Pushes into outlets of every kind until it is stopped.

    The strap loses 260 samples, which the counters say. Of its heart rate they claim
    samples that were never pushed, which to a recording looks like its own loss.
    """

    def __init__(self) -> None:
        strap, agent = declaration("polar_h10"), declaration("gateway")
        self.ecg = Outlet(strap.stream("ecg"), STRAP, DeviceInfo())
        self.heart_rate = Outlet(strap.stream("hr"), STRAP, DeviceInfo())
        self.counters = Outlet(agent.stream("counters"), OURS, DeviceInfo())
        self.int64 = _foreign("int64", "int64", 10)
        self.unix = _foreign("unix", "float32", 10)
        self.empty = _foreign("empty", "float32", 10)
        self.deduced = _foreign("deduced", "double64", 100, channels=2)
        self.duplicates = [_foreign("twin", "int16", 0, f"twin-{side}-{STREAM}") for side in "ab"]
        self.recording = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._push_all)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def _push_all(self) -> None:
        begin, step = pylsl.local_clock(), 0
        gap_at: int | None = None
        while not self._stop.wait(max(0.0, begin + step * STEP_S - pylsl.local_clock())):
            now = begin + step * STEP_S
            per_step = int(ECG_HZ * STEP_S)
            if self.recording.is_set() and gap_at is None:
                gap_at = step + 20
            if gap_at is not None and gap_at <= step < gap_at + GAP_SAMPLES // per_step:
                self.ecg.counters.lost += per_step
            else:
                self.ecg.push(np.ones(per_step), [now + k / ECG_HZ for k in range(per_step)])
            self._push_foreign(now)
            if step % 10 == 0:
                self._push_each_second(now, claimed=INVENTED if gap_at is not None else 0)
            step += 1

    def _push_foreign(self, now: float) -> None:
        self.int64.push_sample([1], now)
        self.unix.push_sample([1.0], time.time())
        # One stamp for all: the library works out those of the others.
        self.deduced.push_chunk(np.full((10, 2), np.nan), now)
        for duplicate in self.duplicates:
            duplicate.push_sample([1], now)

    def _push_each_second(self, now: float, claimed: int) -> None:
        self.heart_rate.push([[70.0]], [now])
        told: Mapping[str, Counters] = {
            self.ecg.source_id: self.ecg.counters,
            self.heart_rate.source_id: replace(
                self.heart_rate.counters, pushed=self.heart_rate.counters.pushed + claimed
            ),
        }
        self.counters.push_text(counters_text(told), pylsl.local_clock())


@contextmanager
def _outlets() -> Generator[Outlets]:
    outlets = Outlets()
    try:
        yield outlets
    finally:
        outlets.stop()


def _record_and_kill(path: Path) -> None:
    with LabRecorder(path, at_least=STREAMS) as recorder:
        deadline = time.monotonic() + 30
        while path.stat().st_size < ENOUGH_BYTES:
            assert time.monotonic() < deadline, "nothing was recorded"
            time.sleep(0.1)
        recorder.kill()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of the same outlets: one as it should be, one whose recorder died."""
    folder = tmp_path_factory.mktemp("recordings")
    with _outlets() as outlets:
        with LabRecorder(folder / "whole.xdf", at_least=STREAMS):
            time.sleep(2)
            outlets.recording.set()
            time.sleep(RECORD_S - 2)
        _record_and_kill(folder / "killed.xdf")
    return folder


@pytest.fixture(scope="module")
def report(folder: Path) -> Report:
    return judge(read_recording(folder / "whole.xdf"))


def _stream(report: Report, name: str) -> Measured:
    (measured,) = (each for each in report.streams if each.name == name)
    return measured


@pytest.mark.seam
def test_every_sample_is_read_that_pyxdf_reads(report: Report, folder: Path) -> None:
    theirs = load_by_pyxdf(folder / "whole.xdf")
    assert [each.name for each in report.streams] == [s["info"]["name"][0] for s in theirs]
    for measured, their in zip(report.streams, theirs, strict=True):
        assert measured.stream.stamps == pytest.approx(their["time_stamps"], abs=1e-9, rel=0)
        assert len(measured.stream.clock_offsets) == len(their["clock_times"])


def test_all_errors_are_found_and_no_other(report: Report) -> None:
    assert codes(report, Level.ERROR) == {
        ("int64", f"int64-{STREAM}"),
        ("wrong-clock", f"unix-{STREAM}"),
        ("no-samples", f"empty-{STREAM}"),
        ("not-recorded", f"polar_h10-{STREAM}-hr"),
    }
    assert text_of(report, "not-recorded", f"polar_h10-{STREAM}-hr").startswith(f"{INVENTED} of")
    assert "unix time" in text_of(report, "wrong-clock", f"unix-{STREAM}")


def test_the_gap_is_found_where_it_is(report: Report) -> None:
    ecg = _stream(report, f"polar_h10-{STREAM}-ecg")
    (gap,) = ecg.figures.gaps.listed
    assert gap.lost == GAP_SAMPLES
    assert gap.length_s == pytest.approx((GAP_SAMPLES + 1) / ECG_HZ)
    assert ecg.counters is not None
    assert ecg.counters.pushed == ecg.counters.held > 0
    assert ecg.counters.lost == GAP_SAMPLES
    assert ecg.figures.rate_between_gaps_hz == pytest.approx(ECG_HZ)
    assert {("gaps", ecg.name), ("lost", ecg.name)} <= codes(report, Level.WARNING)
    assert ("smeared-gaps", ecg.name) not in codes(report)


def test_duplicates_are_named(report: Report) -> None:
    assert f"twin-{STREAM}" in text_of(report, "duplicate-name")


def test_whose_streams_they_are(report: Report) -> None:
    ours = {each.name for each in report.streams if each.stream.header.is_ours}
    assert ours == {
        f"polar_h10-{STREAM}-ecg",
        f"polar_h10-{STREAM}-hr",
        f"gateway-{STREAM}-counters",
    }


@pytest.mark.seam
def test_values_and_offsets(report: Report) -> None:
    deduced = _stream(report, f"deduced-{STREAM}")
    assert deduced.figures.nan_shares == (1.0, 1.0)
    assert deduced.figures.offsets.count >= 1
    for each in report.streams:
        if each.name != f"int64-{STREAM}":
            assert each.stream.footer is not None
            assert each.stream.footer.sample_count == each.stream.sample_count


def test_a_recorder_that_died(folder: Path) -> None:
    report = judge(read_recording(folder / "killed.xdf"))
    assert len(report.streams) == 9
    assert ("not-closed", "") in codes(report, Level.ERROR)
    ecg = _stream(report, f"polar_h10-{STREAM}-ecg")
    assert ecg.stream.sample_count > 0
    assert ecg.counters is not None
    assert ecg.counters.pushed == ecg.counters.held


def test_a_real_recording_that_breaks_off_anywhere(folder: Path, tmp_path: Path) -> None:
    content = (folder / "whole.xdf").read_bytes()
    ends = chunk_ends(content)
    assert ends[-1] == len(content)
    generator = random.Random(5)
    path = tmp_path / "cut.xdf"
    held = -1
    for end in sorted({*ends[:-1], *generator.sample(range(4, len(content)), 200)}):
        path.write_bytes(content[:end])
        report = judge(read_recording(path))
        assert not report.is_good
        assert as_text(report)
        assert as_json(report)
        assert len(report.recording.damages) == (0 if end in (4, *ends) else 1)
        before, held = held, sum(each.stream.sample_count for each in report.streams)
        assert before <= held
    assert held > 1000
