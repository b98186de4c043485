"""Recordings with LabRecorder's real program and real streams."""

from __future__ import annotations

import json
import resource
import signal
import socket
import struct
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import psutil
import pylsl
import pytest
import pyxdf

from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import Presence
from biosensor_gateway.recording.recorder.programs import launch
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    LocalStatus,
    NotClosedError,
    RecorderError,
    RecorderReason,
    RecordingRequest,
    VisibleStream,
)
from biosensor_gateway.recording.recorder.state import LAB_RECORDER, OWN, RecorderFolder
from biosensor_gateway.recording.xdf.findings import Level, by_event
from biosensor_gateway.recording.xdf.verdict import Colour
from tests.lab_recorder.conftest import CommandLine, Outcome
from tests.recording_here.conftest import Sources, begin, only
from tests.rigs.compiler import compile_c
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

SHIFTED_CLOCK = Path(__file__).parents[1] / "rigs" / "shifted_clock.c"
BIDS = BidsLabels("P07", task="Walk")
NAME = "sub-P07/ses-S001/beh/sub-P07_ses-S001_task-Walk_run-{run:03}_beh.xdf"

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def request_of(folder: Path, **more: Any) -> RecordingRequest:
    return RecordingRequest(folder, labels=BIDS, growth_s=60.0, **more)


def standing(recording: LocalRecorder) -> LocalStatus:
    found = recording.status()
    assert found is not None
    json.dumps(asdict(found), allow_nan=False, default=str)
    return found


def codes(recording: LocalRecorder) -> dict[str, str]:
    return {each.stream: each.code for each in standing(recording).problems}


def loaded(file: Path) -> dict[str, int]:
    streams, _ = _load_xdf(str(file))
    return {each["info"]["source_id"][0]: len(each["time_stamps"]) for each in streams}


def test_a_stream_that_stops_is_said_and_one_that_comes_back_too(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    recording = LocalRecorder(state)
    assert recording.status() is None
    begun = begin(recording, request_of(tmp_path), sources.presence())
    assert begun.file == tmp_path / NAME.format(run=1)
    assert {each.name for each in begun.streams} == {"chest", "wrist"}
    with pytest.raises(RecorderError) as caught:
        begin(recording, request_of(tmp_path), sources.presence())
    assert caught.value.reason is RecorderReason.RECORDING

    def samples(name: str) -> int:
        sight = standing(recording).sight
        assert sight is not None
        return sum(each.samples for each in sight.streams if each.name == name)

    wait_until(lambda: samples("chest") and samples("wrist"), "both grow")
    assert codes(recording) == {}
    sources.remove("wrist")
    wait_until(lambda: codes(recording) == {"wrist": "stopped"}, "it is said")
    before = samples("wrist")
    # Another process reads the file from its beginning, and finds the same.
    assert codes(LocalRecorder(state)) == {"wrist": "stopped"}
    sources.add("wrist")
    wait_until(lambda: samples("wrist") > before, "it is recorded again")
    # It stays said to the end that there is a gap, which of another program's stream is known once
    # there are enough samples behind it.
    wait_until(lambda: codes(recording) == {"wrist": "gaps"}, "the gap is said")

    ended = recording.stop()
    json.dumps(asdict(ended), allow_nan=False, default=str)
    assert (ended.streams, ended.with_samples) == (2, 2)
    found = [each for each in ended.verdict.findings if each.level is Level.ERROR]
    assert (ended.verdict.colour, found) == (Colour.AMBER, [])
    assert {each.code for each in ended.verdict.findings} >= {"gaps"}
    read = loaded(ended.file)
    assert read["chest-id"] > read["wrist-id"] > before
    assert recording.status() is None
    with pytest.raises(RecorderError) as caught:
        recording.stop()
    assert caught.value.reason is RecorderReason.NOT_RECORDING


@pytest.mark.parametrize("only_ours", [False, True])
def test_a_stream_that_appears_later_is_not_in_it_which_is_said_unless_it_was_not_wanted(
    sources: Sources, state: Path, tmp_path: Path, only_ours: bool
) -> None:
    recording = LocalRecorder(state)
    begin(recording, request_of(tmp_path, only_ours=only_ours), sources.presence())
    sources.add("markers")
    folder = RecorderFolder(state)
    if only_ours:
        time.sleep(12.0)  # Two looks for such streams.
    else:
        wait_until(lambda: codes(recording) == {"": "late-stream"}, "it is said")
    # Their program often ends before the recording does.
    sources.remove("markers")
    saved = folder.saved()
    assert saved is not None
    assert [each.name for each in saved.late] == ([] if only_ours else ["markers"])
    ended = recording.stop()
    late = [each for each in ended.verdict.findings if each.code == "late-stream"]
    assert ended.streams == 2
    if only_ours:
        assert late == []
    else:
        assert ended.verdict.colour is Colour.AMBER
        (found,) = late
        assert found.text.startswith("markers (")
        assert "appeared after the recording began, and is not in it" in found.text


def test_a_clock_that_is_set_back_is_said(
    sources: Sources, state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, shift = tmp_path / "shifted_clock.so", tmp_path / "shift"
    compile_c(SHIFTED_CLOCK, library, "-shared", "-fPIC")
    shift.write_bytes(struct.pack("q", 0))
    recording = LocalRecorder(state)
    with monkeypatch.context() as shifted:
        shifted.setenv("LD_PRELOAD", str(library))
        shifted.setenv("SHIFT_FILE", str(shift))
        begin(recording, request_of(tmp_path), sources.presence())
    wait_until(lambda: codes(recording) == {}, "both are recorded")

    def set_clock(by_s: int) -> None:
        # In place, because the programs have mapped it.
        with shift.open("r+b") as file:
            file.write(struct.pack("q", by_s * 1_000_000_000))

    def steps() -> list[str]:
        found = standing(recording).problems
        return [each.text for each in found if each.code == "clock-set"]

    set_clock(-1000)
    wait_until(steps, "it is said")
    # LabRecorder's program waits for the time of day that it had.
    set_clock(0)
    wait_until(lambda: len(steps()) == 2, "both are said")
    ended = recording.stop()
    texts = [each.text for each in ended.verdict.findings if each.code == "clock-set"]
    assert "set back by 1000.0 s" in texts[0]
    assert "slept for 1000.0 s, or its clock was set forward by that" in texts[1]
    assert ended.verdict.colour is Colour.AMBER


def test_a_program_that_is_started_again_without_a_source_id_is_not_in_it(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    def outlet() -> pylsl.StreamOutlet:
        return pylsl.StreamOutlet(pylsl.StreamInfo("marks", "Markers", 1, 0, "string", ""))

    marks = outlet()
    marks.push_sample(["begin"])
    seen = sources.presence()
    seen = replace(seen, visible=(*seen.visible, VisibleStream("marks", "", socket.gethostname())))
    recording = LocalRecorder(state)
    begin(recording, request_of(tmp_path), seen)
    time.sleep(8.0)  # A look for such streams.
    del marks
    again = outlet()
    again.push_sample(["lost"])
    wait_until(lambda: "late-stream" in codes(recording).values(), "it is said")
    ended = recording.stop()
    found = {each.code: each for each in ended.verdict.findings}
    assert found["late-stream"].text.startswith("marks (")
    assert (found["no-footer"].level, found["no-footer"].stream) == (Level.WARNING, "marks")
    assert ended.verdict.colour is Colour.AMBER


def test_an_interrupt_right_after_the_supervisor_has_started_leaves_no_recording(
    sources: Sources, state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(state: Path) -> None:
        launch(state)
        raise KeyboardInterrupt

    monkeypatch.setattr(local, "launch", interrupted)
    recording = LocalRecorder(state)
    with pytest.raises(KeyboardInterrupt):
        begin(recording, request_of(tmp_path), sources.presence())
    # A supervisor takes a second to look whether it is still wanted.
    until = time.monotonic() + 5.0
    while time.monotonic() < until:
        assert recording.status() is None
        time.sleep(0.1)
    assert not recording.is_running
    assert list(tmp_path.rglob("*.xdf")) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whoever_ends_the_start_has_no_recording(
    sources: Sources, state: Path, tmp_path: Path, number: signal.Signals
) -> None:
    del sources
    command_line = CommandLine(state)
    folder = RecorderFolder(state)
    starting = command_line.begin("record", "start", "--here", "--folder", str(tmp_path))
    wait_until((folder.path / "job.json").exists, "a supervisor is started")
    # Python ignores an interrupt in a destructor, such as that of the lock which is let go now.
    time.sleep(0.3)
    starting.send_signal(number)
    _, said = starting.communicate(timeout=30.0)
    assert starting.returncode == 130, said
    time.sleep(3.0)  # As above.
    assert not folder.is_running
    assert folder.saved() is None
    assert list(tmp_path.rglob("*.xdf")) == []


def test_a_name_that_is_taken_counts_up_or_refuses(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    taken = tmp_path / NAME.format(run=1)
    taken.parent.mkdir(parents=True)
    taken.write_bytes(b"of somebody")
    recording = LocalRecorder(state)
    with pytest.raises(RecorderError) as caught:
        begin(recording, request_of(tmp_path, counts_up=False), sources.presence())
    assert caught.value.reason is RecorderReason.EXISTS
    begun = begin(recording, request_of(tmp_path), sources.presence())
    assert begun.file == tmp_path / NAME.format(run=2)
    assert recording.stop().file == tmp_path / NAME.format(run=2)
    assert taken.read_bytes() == b"of somebody"


@pytest.mark.seam
def test_a_required_stream_that_is_missing_refuses(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    recording = LocalRecorder(state)
    missing = "p01 zephyr (x), none of its 13 streams"
    with pytest.raises(RecorderError, match="p01 zephyr") as caught:
        begin(recording, request_of(tmp_path / "data"), sources.presence(missing))
    assert caught.value.reason is RecorderReason.STREAMS_MISSING
    assert not (tmp_path / "data").exists()


def test_a_required_stream_that_the_program_does_not_find_refuses(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    gone = sources.presence()
    sources.remove("wrist")
    recording = LocalRecorder(state)
    short = RecordingRequest(tmp_path, labels=BIDS, growth_s=5.0)
    with pytest.raises(RecorderError, match="wrist") as caught:
        begin(recording, short, gone)
    assert caught.value.reason is RecorderReason.STREAMS_MISSING
    assert not recording.is_running


def test_a_refusal_gives_the_name_back_if_no_sample_came(state: Path, tmp_path: Path) -> None:
    silent = pylsl.StreamOutlet(pylsl.StreamInfo("silent", "Markers", 1, 0, "string", "silent-id"))
    host = socket.gethostname()
    seen = tuple(VisibleStream(each, f"{each}-id", host) for each in ("silent", "gone"))
    presence = Presence(seen, (), ())
    short = RecordingRequest(tmp_path, labels=BIDS, growth_s=5.0)
    with pytest.raises(RecorderError, match="gone") as caught:
        begin(LocalRecorder(state), short, presence)
    assert caught.value.reason is RecorderReason.STREAMS_MISSING
    assert not list(tmp_path.rglob("*.xdf"))
    del silent


def test_where_nothing_can_be_written_it_says_so(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    # Where root may not write either.
    for folder in (tmp_path / "data", Path("/proc/data")):
        if folder.parent == tmp_path:
            folder.touch()
        with pytest.raises(RecorderError, match=r"no folder|cannot be written") as caught:
            begin(LocalRecorder(state), request_of(folder), sources.presence())
        assert caught.value.reason is RecorderReason.UNWRITABLE


STARTER = """
import sys, time
from pathlib import Path
from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.request import BidsLabels, RecordingRequest
from biosensor_gateway.recording.recorder.presence import (Presence)
from biosensor_gateway.recording.recorder.request import VisibleStream
from biosensor_gateway.settings.models import GatewaySettings
import socket

seen = [VisibleStream(name, name + "-id", socket.gethostname()) for name in ("chest", "wrist")]
request = RecordingRequest(Path(sys.argv[2]), labels=BidsLabels("P07", task="Walk"))
local.look = lambda *_: Presence(tuple(seen), (), ())
local.LocalRecorder(Path(sys.argv[1])).start(request, GatewaySettings())
print("begun", flush=True)
time.sleep(600)
"""


@pytest.mark.usefixtures("sources")
def test_a_recording_outlives_who_began_it(state: Path, tmp_path: Path) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", STARTER, str(state), str(tmp_path)], stdout=subprocess.PIPE
    )
    with parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"begun\n"
        parent.kill()
    recording = LocalRecorder(state)
    first = standing(recording).sight
    assert first is not None
    wait_until(lambda: _bytes(recording) > first.bytes, "it goes on")
    ended = recording.stop()
    assert set(loaded(ended.file)) == {"chest-id", "wrist-id"}


def _bytes(recording: LocalRecorder) -> int:
    sight = standing(recording).sight
    return 0 if sight is None else sight.bytes


class Begun(NamedTuple):
    """A recording that runs, by one recorder."""

    recording: LocalRecorder
    by: str
    program: psutil.Process
    supervisor: psutil.Process


@pytest.fixture(params=[LAB_RECORDER, OWN])
def begun(
    request: pytest.FixtureRequest,
    sources: Sources,
    state: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Begun:
    only(request.param, monkeypatch)
    recording = LocalRecorder(state)
    begin(recording, request_of(tmp_path), sources.presence())
    kept = RecorderFolder(state).saved()
    assert kept is not None
    assert kept.recorder == request.param
    program = psutil.Process(kept.program)
    supervisor = program.parent()
    assert supervisor is not None
    return Begun(recording, kept.recorder, program, supervisor)


@pytest.mark.seam
def test_a_killed_program_is_said_with_what_it_said(begun: Begun) -> None:
    recording = begun.recording
    begun.program.kill()
    wait_until(lambda: not recording.is_running, "its supervisor has noticed")
    assert codes(recording) == {"": "ended"}
    with pytest.raises(RecorderError, match="killed by SIGKILL") as caught:
        recording.stop()
    assert caught.value.reason is RecorderReason.NOT_CLOSED
    assert begun.by in str(caught.value)
    assert "Started data collection" in str(caught.value)


@pytest.mark.seam
def test_a_killed_supervisor_closes_the_file(begun: Begun) -> None:
    begun.supervisor.kill()
    wait_until(lambda: not begun.recording.is_running, "the lock is given back")
    ended = begun.recording.stop()
    assert any("supervisor was killed" in each for each in ended.warnings)
    assert set(loaded(ended.file)) == {"chest-id", "wrist-id"}


@pytest.mark.parametrize("recorder", [LAB_RECORDER, OWN])
def test_a_program_that_ends_early_is_said_where_no_rate_shows_it(
    recorder: str, sources: Sources, state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(recorder, monkeypatch)
    sources.add("watch", rate_hz=0)
    recording = LocalRecorder(state)
    begin(recording, request_of(tmp_path), sources.presence())
    wait_until(lambda: codes(recording) == {}, "all is there")
    time.sleep(6.0)
    sources.remove("watch")
    wait_until(lambda: codes(recording) == {"watch": "no-offsets"}, "it is said")
    ended = recording.stop()
    assert ended.verdict.colour is Colour.AMBER
    (found,) = (each for each in ended.verdict.findings if each.level is Level.WARNING)
    assert (found.code, found.stream) == ("no-answer", "watch")
    assert "to the end: the program had ended, so" in found.text


@pytest.mark.parametrize("recorder", [LAB_RECORDER, OWN])
def test_a_recording_that_outlives_all_its_streams_is_not_green(
    recorder: str, sources: Sources, state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(recorder, monkeypatch)
    recording = LocalRecorder(state)
    begin(recording, request_of(tmp_path), sources.presence())
    time.sleep(8.0)
    for name in ("chest", "wrist"):
        sources.remove(name)
    time.sleep(25.0)
    ended = recording.stop()
    assert ended.verdict.colour is Colour.AMBER
    assert ended.verdict.length_s > 20.0
    heads = by_event([e for e in ended.verdict.findings if e.code in ("no-answer", "ends-early")])
    ((cause, parts),) = heads
    assert ": no answer from " in cause.text
    assert {each.stream for each in parts} == {"chest", "wrist"}


def test_a_supervisor_that_its_service_ends_closes_the_file(begun: Begun) -> None:
    # As systemd does: all processes of the service.
    for process in (begun.program, begun.supervisor):
        process.terminate()
    wait_until(lambda: not begun.recording.is_running, "it has ended")
    assert set(loaded(begun.recording.stop().file)) == {"chest-id", "wrist-id"}


def let_the_disk_be_full(program: psutil.Process) -> None:
    resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (100_000, 100_000))


@pytest.mark.parametrize("begun", [LAB_RECORDER], indirect=True)
def test_a_full_disk_is_said_though_the_program_says_nothing(begun: Begun) -> None:
    recording = begun.recording
    let_the_disk_be_full(begun.program)
    wait_until(lambda: codes(recording) == {"": "still"}, "that it does not grow is said")
    with pytest.raises(NotClosedError, match="disk is full") as caught:
        recording.stop()
    assert caught.value.reason is RecorderReason.NOT_CLOSED
    verdict = caught.value.verdict
    assert verdict is not None
    assert (verdict.colour, verdict.can_be_salvaged) == (Colour.RED, True)


@pytest.mark.parametrize("begun", [OWN], indirect=True)
def test_a_full_disk_is_said_at_once_by_our_own(begun: Begun) -> None:
    recording = begun.recording
    let_the_disk_be_full(begun.program)
    wait_until(lambda: not recording.is_running, "it has ended")
    assert "cannot be written: File too large" in standing(recording).problems[0].text
    with pytest.raises(RecorderError, match="File too large") as caught:
        recording.stop()
    assert caught.value.reason is RecorderReason.NOT_CLOSED


# ``record`` where no window of LabRecorder is open.

Record = Callable[..., Outcome]


@pytest.fixture
def record(state: Path) -> Record:
    """``record`` beside no agent; what a test leaves running is ended with `state`."""
    command_line = CommandLine(state)

    def run(command: str, *arguments: str) -> Outcome:
        return command_line("record", command, *arguments)

    return run


@pytest.mark.seam
def test_it_records_until_it_is_stopped(
    record: Record, sources: Sources, state: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "OneDrive"
    folder.mkdir()
    start = ("start", "--here", "--folder", str(folder), "--participant", "P07")
    begun = record(*start, "--json")
    assert begun.code == 0, begun.err
    file = begun.json["file"]
    # It has made the state folder, into which nobody else looks.
    assert state.stat().st_mode & 0o077 == 0
    assert (begun.json["by"], Path(file).parents[3]) == ("gateway", folder)
    # Nobody's agent has them, and they are recorded all the same.
    assert {each["name"] for each in begun.json["foreign"]} == {"chest", "wrist"}
    assert "--only-ours" in begun.json["warnings"][0]
    assert begun.json["warnings"][-1].startswith("OneDrive copies")

    again = record(*start)
    assert again.code == 1
    assert f"already recording, to {file}" in again.err
    wait_until(lambda: _samples(record("status", "--json")) > 0, "it grows")
    during = record("status")
    assert during.code == 0, during
    assert f"recording to {file}" in during.out
    assert "chest" in during.out

    ended = record("stop")
    assert ended.code == 0, ended.err
    assert f"{file} is closed" in ended.out
    assert ended.out.splitlines()[-1].split(":")[0] in {"green", "amber"}
    del sources


def test_where_no_folder_is_named_it_is_that_of_the_page(
    state: Path, sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Where Linux keeps documents, and where Windows and macOS do without being asked.
    (tmp_path / "Documents").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_DOCUMENTS_DIR", str(tmp_path / "Documents"))
    command_line = CommandLine(state)
    begun = command_line("record", "start", "--here", "--participant", "P07", "--json")
    assert begun.code == 0, begun.err
    assert command_line("record", "stop").code == 0
    folder = tmp_path / "Documents" / "Biosensor recordings"
    assert Path(begun.json["file"]).is_relative_to(folder)
    del sources


@pytest.mark.parametrize("is_red", [False, True])
def test_a_script_may_ask_for_a_verdict_that_is_not_red(
    is_red: bool, record: Record, sources: Sources, tmp_path: Path
) -> None:
    silent = pylsl.StreamInfo("silent", "EEG", 1, 2000 if is_red else 0, "float32", "silent-id")
    outlet = pylsl.StreamOutlet(silent)
    for options, code in (((), 0), (("--fail-on-red",), int(is_red))):
        file = tmp_path / f"{len(options)}.xdf"
        begun = record("start", "--here", "--file", str(file), "--all", "--json")
        assert begun.code == 0, begun.err
        # A stream without samples is an error there, too.
        wait_until(partial(_is_larger, Path(begun.json["file"]), 500_000), "it grows")
        ended = record("stop", *options)
        assert ended.code == code, ended
        assert ended.out.splitlines()[-1].startswith("red") == is_red
    del outlet, sources


def test_virtual_devices_are_recorded_in_the_session_of_the_settings(
    state: Path, record: Record, tmp_path: Path
) -> None:
    """What streams in another session than `record` looks in would not be there for it."""
    command_line = CommandLine(state)
    state.mkdir()
    (state / "none.toml").write_text(f'[lsl]\nsession_id = "{uuid.uuid4().hex}"\n')
    agent = command_line.begin("run", "--no-ask", "--simulate", "zephyr")
    try:
        ready = command_line("wait-ready", "--timeout", "60")
        assert ready.code == 0, ready.err
        begun = record("start", "--here", "--folder", str(tmp_path), "--participant", "P07")
        assert begun.code == 0, begun.err
        assert record("stop").code == 0
        # Settings that are changed now hold for all that starts, but not for the agent.
        (state / "none.toml").write_text('[lsl]\nsession_id = "changed"\n')
        for command in (("record", "start", "--here"), ("doctor", "--only", "settings")):
            looked = command_line(*command)
            assert looked.code == 1
            assert "and the settings now say changed" in " ".join((looked.out + looked.err).split())
    finally:
        agent.terminate()
        agent.communicate(timeout=60)


@pytest.mark.parametrize("command", ["stop", "status"])
def test_there_is_nothing_to_stop_or_to_look_at(record: Record, command: str) -> None:
    outcome = record(command)
    assert outcome.code == 1
    assert "nothing is being recorded here" in outcome.err


def _is_larger(file: Path, size: int) -> bool:
    return file.stat().st_size > size


def _samples(status: Outcome) -> int:
    assert status.code == 0, status
    return sum(each["samples"] for each in status.json["sight"]["streams"])


@pytest.mark.usefixtures("sources")
def test_it_is_watched_until_it_ends(state: Path, record: Record, tmp_path: Path) -> None:
    file = tmp_path / "Night One.xdf"
    assert record("start", "--here", "--file", str(file), "--all").code == 0
    watching = CommandLine(state).watch("record", "status", "--watch", "--json")
    with watching:
        assert watching.stdout is not None
        assert json.loads(watching.stdout.readline())["file"] == str(file)
        assert record("stop", "--file", str(file)).code == 0
        lines = watching.stdout.read().splitlines()
    assert all(json.loads(line)["file"] == str(file) for line in lines)
    assert watching.returncode == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("--here", "--file", "a.txt"),
        ("--here", "--folder", "x", "--participant", "Jane Doe"),
        ("--here", "--window", "--folder", "x"),
        ("--here", "--host", "lab-pc", "--folder", "x"),
    ],
)
def test_a_wrong_command_is_a_usage_error(record: Record, arguments: tuple[str, ...]) -> None:
    outcome = record("start", *arguments)
    assert (outcome.code, outcome.out) == (2, "")


def test_only_what_this_agent_has_is_refused_without_an_agent(
    record: Record, sources: Sources, tmp_path: Path
) -> None:
    refused = record("start", "--here", "--folder", str(tmp_path / "x"), "--only-ours")
    assert refused.code == 1
    assert "no LSL stream of this agent" in refused.err
    assert not (tmp_path / "x").exists()
    del sources


def test_a_window_in_any_case_is_a_window(record: Record, tmp_path: Path) -> None:
    refused = record("start", "--window", "--port", "1", "--folder", str(tmp_path))
    assert refused.code == 1
    assert "EnableRCS" in refused.err
