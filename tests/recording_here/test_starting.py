"""A recording that takes several tries to begin, with a supervisor that is none."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.status_file import write_status
from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.live_file import Growth
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import Presence, doubles, expected_devices
from biosensor_gateway.recording.recorder.programs import ClockWatch
from biosensor_gateway.recording.recorder.recording_file import FileSummary, summarize
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
    VisibleStream,
)
from biosensor_gateway.recording.recorder.state import (
    ClockStep,
    RecorderFolder,
    SavedRecording,
    lost_by_start,
)
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.verdict import Colour, Verdict
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from tests.recording_here.conftest import begin
from tests.recording_here.test_growth import HEAD, TWO, data, events_with_steps
from tests.xdf import xdf_file as x
from tests.xdf.test_participants import heartbeat, recorded, strap


def test_the_next_try_begins_with_an_empty_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, sizes = tmp_path / "a.xdf", list[int]()

    def launch(state: Path) -> None:
        """Find no stream, having written something; the second time, not even run."""
        sizes.append(file.stat().st_size)
        if len(sizes) == 2:
            raise OSError("enough")
        file.write_bytes(b"XDF: and what was found")
        folder = RecorderFolder(state)
        folder.save(replace(folder.requested(), started=time.time(), ended=time.time(), code=2))

    monkeypatch.setattr(local, "launch", launch)
    stream = VisibleStream("a", "a-id", "here")
    with pytest.raises(RecorderError) as refused:
        begin(
            local.LocalRecorder(tmp_path / "state"),
            RecordingRequest(file=file),
            Presence((stream,), (), ()),
        )
    assert refused.value.reason is RecorderReason.UNWRITABLE
    assert sizes == [0, 0]


@pytest.mark.parametrize(
    ("has_begun", "last"), [(True, "waiting for P01-a"), (False, "no such library")]
)
def test_what_does_not_begin_in_time_tells_its_own_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_begun: bool, last: str
) -> None:
    def launch(state: Path) -> None:
        folder = RecorderFolder(state)
        folder.supervisor_log.write_text("no such library\n")
        folder.output.write_text("waiting for P01-a\n")
        if has_begun:
            folder.save(replace(folder.requested(), started=time.time()))

    monkeypatch.setattr(local, "launch", launch)
    for limit in ("PROGRAM_S", "LAST_PROGRAM_S", "_SUPERVISOR_S"):
        monkeypatch.setattr(local, limit, 0.0)
    with pytest.raises(RecorderError, match=f"its last output was: {last}"):
        begin(
            local.LocalRecorder(tmp_path / "state"),
            RecordingRequest(file=tmp_path / "a.xdf"),
            Presence((VisibleStream("a", "a-id", "here"),), (), ()),
        )


@pytest.mark.parametrize("is_ours", [True, False])
def test_an_agent_in_another_session_is_not_recorded(tmp_path: Path, is_ours: bool) -> None:
    """There, streams of the same source_ids are another group's."""
    own = api_file.session(api_file.config_here(LslOverrides()))
    session = own if is_ours else "before-the-change"
    write_status(tmp_path, {"written": time.time(), "devices": [], "session": session})
    if is_ours:
        assert expected_devices(GatewaySettings(), tmp_path) == ()
        return
    with pytest.raises(RecorderError, match="the LSL session before-the-change, and") as refused:
        expected_devices(GatewaySettings(), tmp_path)
    assert refused.value.reason is RecorderReason.OTHER_SESSION


def test_two_streams_of_one_name_are_told_when_it_begins() -> None:
    ours, other = VisibleStream("P01-a", "P01@a", "here"), VisibleStream("b", "b-id", "there")
    robot = VisibleStream("b", "other-id", "robot")

    def told(*streams: VisibleStream, only_ours: bool = False) -> list[str]:
        wanted = [each for each in streams if each == ours] if only_ours else streams
        return list(doubles(Presence(streams, (other, robot), ()), wanted))

    assert told(ours, other) == []
    (sentence,) = told(ours, ours, other)
    assert sentence.startswith("P01-a (here) exist twice each: another agent uses")
    # Of others a copied source_id, or the topics of two robots.
    for second in (other, robot):
        (sentence,) = told(ours, other, second)
        assert sentence.startswith(f"b (there), b ({second.host}) have the same name")
        assert told(ours, other, second, only_ours=True) == []


AWAY = "polar_h10/A1 of P01 was paused the whole time, and "


@pytest.fixture(autouse=True)
def empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.xdf.test_participants.STAMPS", [])
    # Nobody writes the file, so there is no need to wait until that has ended.
    monkeypatch.setattr(local, "wait_until_closed", _closed)


def _closed(file: Path, *_: object) -> FileSummary:
    return summarize(file)


def ended(folder: Path, *without: str) -> Verdict:
    """End a recording in which a strap of P01 has sent nothing."""
    file = folder / "sub-P01_ses-S001_task-Default_run-001_eeg.xdf"
    other = DeviceIdentity("zephyr", "B", "P01")
    events: list[object] = [heartbeat(polar_h10__A1="paused", zephyr__B="streaming")]
    file.write_bytes(recorded(strap("P01"), other, events=events))
    kept = SavedRecording(str(file), (), started=1.0, ended=2.0, code=0, without=without)
    recorder = RecorderFolder(folder)
    recorder.hand_over(kept, "")
    recorder.save(kept)
    return LocalRecorder(folder).stop().verdict


@pytest.mark.parametrize(
    ("without", "said", "colour"),
    [
        (
            ("P01@polar_h10-hr", "P01@polar_h10-ecg"),
            "was left out on purpose: it is not in the recording",
            Colour.AMBER,
        ),
        (("P01@zephyr-hr",), "none of its data was recorded", Colour.RED),
    ],
)
def test_it_is_amber_with_a_sentence_and_red_without_a_word_of_a_person(
    tmp_path: Path, without: tuple[str, ...], said: str, colour: Colour
) -> None:
    verdict = ended(tmp_path, *without)
    assert [each.text for each in verdict.findings if each.code == "away"] == [f"{AWAY}{said}"]
    assert verdict.colour is colour


# What is said of a recording whose sensors are paused or away.
STARTED = 1000.0


def device(source: str, **changes: Any) -> dict[str, Any]:
    return {
        "sensor": "zephyr", "unit": source, "participant": "P03", "label": "", "state": "streaming",
        "paused": False, "error": None, "since": None,
        "streams": {source: {"silent": False}}, **changes,
    }  # fmt: skip


class Running:
    """A recording that goes on, of streams ``one`` and ``two``, of which the first stops."""

    def __init__(self, folder: Path) -> None:
        file = folder / "a.xdf"
        first = [101.0 + k / 10 for k in range(10)]
        seconds = [data(2, *(each + second for each in first)) for second in range(30)]
        file.write_bytes(HEAD + TWO + data(1, *first) + b"".join(seconds))
        self._recording = LocalRecorder(folder)
        self._recorder = RecorderFolder(folder)
        self._recorder.path.mkdir()
        self._saved = SavedRecording(str(file), (), STARTED)
        self._recorder.save(self._saved)

    def is_without(self, *sources: str) -> None:
        """Note that the user was asked, and does without these."""
        self._recorder.save(replace(self._saved, without=sources))

    def tells(self, events: bytes) -> None:
        """Append what agents tell."""
        with Path(self._saved.file).open("ab") as file:
            file.write(events)

    def has_steps(self, *steps: ClockStep) -> None:
        """Note that the computer's clock was set."""
        self._recorder.save(replace(self._saved, clock_steps=steps))

    def findings(self, devices: list[dict[str, Any]] | None) -> list[tuple[Level, str, str]]:
        standing = self._recording.status(devices)
        assert standing is not None
        found = [each for each in standing.problems if each.code not in ("no-offsets", "still")]
        return [(each.level, each.code, each.text) for each in found]


@pytest.fixture
def running(tmp_path: Path) -> Generator[Running]:
    made = Running(tmp_path)
    lock = RecorderFolder(tmp_path).try_lock()
    assert lock is not None
    yield made
    lock.release()


def test_a_pause_is_amber_with_its_sentence_and_its_streams_are_not_red(running: Running) -> None:
    devices = [device("one-id", paused=True, since=STARTED + 5), device("two-id")]
    ((level, code, text),) = running.findings(devices)
    assert (level, code) == (Level.WARNING, "away")
    assert "P03's" in text and "is paused since" in text


@pytest.mark.parametrize(
    ("by_s", "level", "said"),
    [
        (-60.0, Level.ERROR, "set back by 60.0 s, .* writes nothing until .*: stop it only then"),
        (-3600.0, Level.ERROR, "set back by 3600.0 s, .*: stop, and record again"),
        (20.0, Level.WARNING, "slept for 20.0 s, or its clock was set forward by that"),
    ],
)
def test_a_step_of_the_clock_is_said_and_what_labrecorder_makes_of_it(
    running: Running, monkeypatch: pytest.MonkeyPatch, by_s: float, level: Level, said: str
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    running.has_steps(ClockStep(time.time() - 1.0, by_s))
    told = running.findings([device("one-id"), device("two-id")])
    ((found, text),) = ((each, text) for each, code, text in told if code == "clock-set")
    assert found == level
    assert re.search(said, text), text


def test_what_an_agent_told_of_its_clock_hides_no_other_step(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    running.tells(events_with_steps((1001.0, 0.0), (1006.0, 20.0)))
    now = time.time()
    running.has_steps(*(ClockStep(now - 2.0, by_s) for by_s in (20.0, 31.0, -60.0)))
    told = running.findings([device("one-id"), device("two-id")])
    steps = [
        (level, *re.findall(r"slept for [\d.]+|set back by [\d.]+", text))
        for level, code, text in told
        if code == "clock-set"
    ]
    # Each once, and the one for which LabRecorder's program waits is red.
    assert steps == [
        (Level.ERROR, "set back by 60.0"),
        (Level.WARNING, "slept for 20.0"),
        (Level.WARNING, "slept for 31.0"),
    ]


def test_steps_of_the_clock_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    day, since_boot = [1.8e9], [500.0]
    monkeypatch.setattr(time, "time", lambda: day[0])
    monkeypatch.setattr(time, "time_ns", lambda: round(day[0] * 1e9))
    monkeypatch.setattr(time, "monotonic", lambda: since_boot[0])
    clock = ClockWatch()
    steps: list[ClockStep] = []
    # What a time service slews, a step back, an hour of work, and a sleep.
    for passed_s, by_s in ((0.1, 0.01), (0.1, -90.0), (3600.0, 0.0), (0.1, 25.0)):
        since_boot[0] += passed_s
        day[0] += passed_s + by_s
        if found := clock.step():
            steps.append(found)
    assert [round(each.by_s, 3) for each in steps] == [-90.0, 25.0]
    saved = SavedRecording("a.xdf", (), 1.8e9, clock_steps=tuple(steps))
    assert day[0] - saved.began == pytest.approx(3600.31)


def test_whoever_is_stopped_between_two_readings_of_a_clock_saw_no_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monotonic, stops = time.monotonic, iter([0.0, 0.0, 2.0, 0.0, 0.0, 4.0])
    late_s = 0.0

    def stopped() -> float:
        nonlocal late_s
        late_s += next(stops, 0.0)
        return monotonic() + late_s

    monkeypatch.setattr(time, "monotonic", stopped)
    monkeypatch.setattr(time, "time_ns", lambda: round((monotonic() + late_s + 1e9) * 1e9))
    clock = ClockWatch()
    assert [clock.step() for _ in range(3)] == [None] * 3


def test_who_was_away_before_it_began_is_amber(running: Running) -> None:
    running.is_without("one-id", "one-other-id")
    away = device("one-id", state="discovering", since=STARTED - 5)
    ((level, code, _),) = running.findings([away, device("two-id")])
    assert (level, code) == (Level.WARNING, "away")


# Before: while the streams are being opened. It was there when *Record* was clicked.
@pytest.mark.parametrize("later_s", [-5, 5])
def test_who_is_lost_without_being_asked_about_is_red(running: Running, later_s: float) -> None:
    away = device("one-id", state="connecting", since=STARTED + later_s)
    found = running.findings([away, device("two-id")])
    # One statement, and not another for each of its streams.
    assert [each[:2] for each in found] == [(Level.ERROR, "away")]


def test_who_streams_and_came_too_late_is_red(running: Running) -> None:
    devices = [device("one-id", paused=True), device("two-id"), device("late")]
    found = running.findings(devices)
    assert found[0][:2] == (Level.ERROR, "left-out")
    assert "stop it and record again" in found[0][2]


def test_without_their_agent_nothing_is_green(running: Running, tmp_path: Path) -> None:
    sources = ("one-id", "two-id")
    RecorderFolder(tmp_path).save(SavedRecording(str(tmp_path / "a.xdf"), sources, STARTED))
    assert (Level.ERROR, "no-agent") in [each[:2] for each in running.findings(None)]


def test_that_no_agent_runs_says_it_of_its_streams_and_not_of_others(tmp_path: Path) -> None:
    file = tmp_path / "a.xdf"
    own = recorded(strap("P01"), events=[heartbeat(polar_h10__A1="streaming")])
    file.write_bytes(own + x.stream_header(20, "eye", kind="Gaze", source_id="eye-id"))
    growth = Growth(file)
    (events,) = (each for each in growth.look().streams if each.source_id.endswith("-events"))
    of_agent = growth.sources_of_agent(events.source_id)
    assert of_agent == {events.source_id, source_id(strap("P01"), "hr")}
    assert growth.sources_of_agent("gateway-elsewhere-events") == {"gateway-elsewhere-events"}


def test_streams_of_others_alone_need_no_agent(running: Running) -> None:
    # As at a computer that only records.
    found = [*running.findings(None), *running.findings([])]
    assert "no-agent" not in [code for _, code, _ in found]


def test_a_start_of_the_agent_without_a_recorded_sensor_is_told_before(tmp_path: Path) -> None:
    strap_of = {each: DeviceSettings(sensor="polar_h10", unit=each) for each in ("A1", "A2")}
    required = [source_id(each.identity, "ecg") for each in strap_of.values()]
    folder = RecorderFolder(tmp_path)
    saved = SavedRecording(str(tmp_path / "a.xdf"), (*required, "gateway-vm-events"), time.time())
    folder.hand_over(saved, "")
    folder.save(saved)
    # Nothing is said of a recording that is over.
    assert not lost_by_start([], tmp_path)
    lock = folder.try_lock()
    assert lock is not None
    with lock:
        assert not lost_by_start(strap_of.values(), tmp_path)
        sentence = lost_by_start([strap_of["A1"]], tmp_path)
        assert f"to {tmp_path / 'a.xdf'}" in sentence
        assert "no longer have polar_h10-A2, with which" in sentence
        off = strap_of["A1"].model_copy(update={"enabled": False})
        assert "polar_h10-A1 and polar_h10-A2" in lost_by_start([off], tmp_path)
