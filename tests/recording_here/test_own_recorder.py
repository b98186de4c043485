# pyright: reportPrivateUsage=false
"""This program's own recorder: what it writes is what LabRecorder writes, and it takes over."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pylsl
import pytest
from numpy.typing import NDArray

from biosensor_common.lsl.predicates import EVERYTHING
from biosensor_gateway.recording.recorder import local, receiver
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import Presence
from biosensor_gateway.recording.recorder.programs import find_programs
from biosensor_gateway.recording.recorder.receiver import ReceivedStream
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    RecordingRequest,
    VisibleStream,
)
from biosensor_gateway.recording.recorder.state import LAB_RECORDER, OWN, RecorderFolder
from biosensor_gateway.recording.xdf.container import Chunk, Tag, open_recording, read_chunks
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.header import parse_stream_header
from biosensor_gateway.recording.xdf.samples import decode
from biosensor_gateway.recording.xdf.verdict import Colour
from tests.recording_here.conftest import Sources, begin, only
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.lsl_streams import note_askers
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

FORMATS = ("float32", "double64", "string", "int32", "int16", "int8", "int64")
OWN_COMMAND = find_programs(Path())[0][OWN]


class Content:
    """What a recorder has written of one stream, as bytes."""

    def __init__(self, xml: bytes) -> None:
        self.xml = xml
        self.header = parse_stream_header(xml)
        self.samples: list[tuple[bytes, bytes]] = []
        self.footer = b""
        self._last = 0.0

    def take(self, content: memoryview) -> None:
        block = decode(content, self.header, self._last)
        self._last = float(block.stamps[-1])
        values: list[bytes] = (
            ["\0".join(each).encode() for each in block.values]
            if isinstance(block.values, list)
            else [each.tobytes() for each in block.values]
        )
        stamps: NDArray[np.float64] = block.stamps
        self.samples += zip((each.tobytes() for each in stamps), values, strict=True)


def contents(file: Path) -> Mapping[str, Content]:
    """Return what is in a recording, by the names of its streams."""
    return {each.header.name: each for each in streams_of(file)}


def streams_of(file: Path) -> list[Content]:
    """Return what is in a recording."""
    streams: dict[int, Content] = {}

    def take(chunk: Chunk) -> None:
        if chunk.tag is Tag.STREAM_HEADER:
            streams[chunk.stream_id] = Content(bytes(chunk.body))
        elif chunk.tag is Tag.SAMPLES:
            streams[chunk.stream_id].take(chunk.body)
        elif chunk.tag is Tag.STREAM_FOOTER:
            streams[chunk.stream_id].footer = bytes(chunk.body)

    with open_recording(file) as (opened, size, _):
        assert not read_chunks(opened, size, take)
    return list(streams.values())


def values_of(stream: Content) -> list[float]:
    """Return the values of a stream of one float32 channel."""
    return [float(np.frombuffer(value, np.float32)[0]) for _, value in stream.samples]


def _value(form: str, number: int) -> Any:
    if form == "string":
        return f"{number} \N{GREEK SMALL LETTER MU}V"
    return number * 1.1 if "o" in form else number % 100


@contextmanager
def every_format() -> Generator[list[str]]:
    """Streams of each format, regular and irregular, that deliver in the block; their names."""
    over = threading.Event()
    outlets: dict[str, tuple[str, pylsl.StreamOutlet]] = {}
    for form in FORMATS:
        for rate in (0, 250):
            name = f"{form} {rate}"
            info = pylsl.StreamInfo(name, "EEG", 3, rate, form, f"{name}-id")
            info.desc().append_child_value("manufacturer", "J\N{GREEK SMALL LETTER MU}rg")
            outlets[name] = form, pylsl.StreamOutlet(info)
    silent = pylsl.StreamInfo("silent", "Markers", 1, 0, "string", "silent-id")
    outlets["silent"] = "", pylsl.StreamOutlet(silent)

    def push() -> None:
        number = 0
        while not over.wait(0.02):
            for form, outlet in outlets.values():
                if form:
                    samples = [[_value(form, number + each)] * 3 for each in range(5)]
                    begun = pylsl.local_clock()
                    outlet.push_chunk(samples, [begun + 0.004 * each for each in range(5)])
            number += 5

    pushing = threading.Thread(target=push)
    pushing.start()
    try:
        yield list(outlets)
    finally:
        over.set()
        pushing.join()


@contextmanager
def own_recorder(file: Path) -> Generator[None]:
    """Record everything with the program itself, as its supervisor runs it."""
    log = file.with_suffix(".log")
    with log.open("wb") as said:
        process = subprocess.Popen(
            [*OWN_COMMAND, file.name, "(true())"],
            cwd=file.parent,
            stdin=subprocess.PIPE,
            stdout=said,
        )
    try:
        wait_until(lambda: "Starting the recording" in log.read_text(), "it records")
        yield
        process.communicate(b"\n", 60)
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait()


def test_it_writes_what_labrecorder_writes_bit_by_bit(tmp_path: Path) -> None:
    """Beside each other: headers, stamps, values and footers of what both were there for."""
    files = tmp_path / "labrecorder.xdf", tmp_path / "own.xdf"
    with every_format() as names, ExitStack() as both:
        both.enter_context(LabRecorder(files[0], at_least=len(names)))
        both.enter_context(own_recorder(files[1]))
        threading.Event().wait(12.0)
    theirs, ours = map(contents, files)
    assert ours.keys() == theirs.keys() == set(names)
    for name in names:
        their, our = theirs[name], ours[name]
        assert our.xml == their.xml, name
        assert bool(our.footer) == bool(their.footer) == ("int64" not in name)
        if "int64" in name or name == "silent":
            assert our.samples == their.samples == []
            continue
        first = their.samples.index(our.samples[0])
        # Neither ends when the other does.
        count = min(len(their.samples) - first, len(our.samples))
        assert count > 1000, name
        assert our.samples[:count] == their.samples[first : first + count], name
        assert b"<sample_count>%d<" % len(our.samples) in our.footer
        assert our.footer.count(b"<offset>") >= 2


def request(folder: Path) -> RecordingRequest:
    return RecordingRequest(folder, labels=BidsLabels("P07"), growth_s=60.0)


@pytest.fixture
def only_own(monkeypatch: pytest.MonkeyPatch) -> None:
    only(OWN, monkeypatch)


def _program(folder: Path, script: str) -> str:
    receiver = folder / "LabRecorderCLI"
    receiver.write_text(f"#!/bin/sh\n{script}\n")
    receiver.chmod(receiver.stat().st_mode | stat.S_IXUSR)
    return str(receiver)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("echo Searching; kill -SEGV $$", "ended by itself: killed by SIGSEGV"),
        ("echo Searching; sleep 600", "does not open all streams in time"),
        # It neither ends at a line, nor when its input does.
        ("trap '' TERM; exec sleep 600 </dev/null", "does not open all streams in time"),
    ],
)
def test_it_takes_over_from_a_program_that_does_not_record(
    sources: Sources,
    state: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    script: str,
    said: str,
) -> None:
    broken = (_program(tmp_path, script),)

    def programs(_folder: Path) -> tuple[dict[str, tuple[str, ...]], list[str]]:
        return {LAB_RECORDER: broken, OWN: OWN_COMMAND}, []

    monkeypatch.setattr(local, "find_programs", programs)
    monkeypatch.setattr(local, "PROGRAM_S", 5.0)
    recording = LocalRecorder(state)
    begun = begin(recording, request(tmp_path), sources.presence())
    (warning,) = (each for each in begun.warnings if OWN[1:] in each)
    assert LAB_RECORDER in warning
    assert said in warning
    kept = RecorderFolder(state).saved()
    assert kept is not None
    assert kept.recorder == OWN
    ended = recording.stop()
    assert set(contents(ended.file)) == {"chest", "wrist"}
    assert ended.file == begun.file


@pytest.mark.usefixtures("only_own")
def test_a_stream_that_does_not_answer_is_named(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    seen = sources.presence().visible
    gone = VisibleStream("gone", "gone-id", socket.gethostname())
    presence = Presence((*seen, gone), (gone,), ())
    short = RecordingRequest(tmp_path, labels=BidsLabels("P07"), growth_s=5.0)
    begun = begin(LocalRecorder(state), short, presence)
    assert any("not recorded: gone" in each for each in begun.warnings)
    assert {each.name for each in begun.streams} == {"chest", "wrist"}


def test_without_a_stream_it_says_so_and_ends(tmp_path: Path) -> None:
    ended = subprocess.run(
        [*OWN_COMMAND, "none.xdf", "(false())"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert ended.returncode == 2


def test_it_goes_on_with_an_outlet_that_was_started_again(tmp_path: Path) -> None:
    file = tmp_path / "again.xdf"
    info = pylsl.StreamInfo("again", "EEG", 1, 0.0, "float32", "again-id")
    other = pylsl.StreamInfo("again", "EEG", 2, 0.0, "float32", "again-id")
    first = pylsl.StreamOutlet(info)
    with own_recorder(file):
        first.push_chunk([[float(each)] for each in range(10)])
        # An outlet that ends at once takes what it has not sent yet along.
        time.sleep(0.1)
        del first
        # Another shape is another stream.
        wrong = pylsl.StreamOutlet(other)
        second = pylsl.StreamOutlet(info)
        wait_until(second.have_consumers, "the recorder goes on")
        second.push_chunk([[float(each)] for each in range(10, 20)])
        del wrong
    (stream,) = contents(file).values()
    assert values_of(stream) == [float(each) for each in range(20)]


def test_what_was_received_is_not_called_lost(tmp_path: Path) -> None:
    file = tmp_path / "ended.xdf"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("ended", "EEG", 1, 0.0, "float32", "ended-id"))
    with own_recorder(file):
        outlet.push_chunk([[float(each)] for each in range(10)])
        # Longer than it takes to be received: an outlet that ends takes along what it has.
        time.sleep(1.0)
        del outlet
        wait_until(lambda: " has ended; " in file.with_suffix(".log").read_text(), "its end")
    assert values_of(contents(file)["ended"]) == [float(each) for each in range(10)]
    assert " has ended; 0 of its samples were not received" in file.with_suffix(".log").read_text()


def test_of_two_that_claim_to_be_one_stream_none_is_recorded_twice(tmp_path: Path) -> None:
    file = tmp_path / "twins.xdf"
    info = pylsl.StreamInfo("twin", "EEG", 1, 0.0, "float32", "twin-id")
    outlets = [pylsl.StreamOutlet(info) for _ in range(2)]
    with own_recorder(file):
        outlets[0].push_chunk([[0.0]])
        outlets[1].push_chunk([[1.0]])
        time.sleep(1.0)
        del outlets[0]
        wait_until(lambda: " has ended; " in file.with_suffix(".log").read_text(), "its end")
        again = pylsl.StreamOutlet(info)
        wait_until(again.have_consumers, "the recorder goes on with the one that is new")
        outlets[0].push_chunk([[1.0]])
        again.push_chunk([[2.0]])
        time.sleep(1.0)
    assert sorted(map(values_of, streams_of(file))) == [[0.0, 2.0], [1.0, 1.0]]


@contextmanager
def recorder_here(monkeypatch: pytest.MonkeyPatch, file: Path) -> Generator[list[str]]:
    """Record everything in this process; what is said."""
    said: list[str] = []
    monkeypatch.setattr(receiver, "_say", said.append)
    over = threading.Event()
    with file.open("wb") as target:
        recorder = receiver._Recorder(target, EVERYTHING)
        running = threading.Thread(target=recorder.run, args=[over])
        running.start()
        try:
            wait_until(lambda: "Starting the recording" in said, "it records")
            yield said
        finally:
            over.set()
            running.join()


def test_an_inlet_of_data_is_never_asked_for_its_clock(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It would measure for the rest of its life, and grow: docs/liblsl-time-receiver.md."""
    asked, pulled = note_askers(monkeypatch)
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("asked", "EEG", 1, 0.0, "float32", "asked-id"))
    file = tmp_path / "asked.xdf"
    with recorder_here(monkeypatch, file):
        outlet.push_sample([1.0])
        wait_until(lambda: asked and pulled, "a measurement")
    assert not {id(each) for each in asked} & {id(each) for each in pulled}
    # Also a recording that ends at once has one.
    assert contents(file)["asked"].footer.count(b"<offset>") >= 1


def test_a_rate_that_somebody_announces_takes_no_memory(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """liblsl reserves it at once, here for inlet and outlet: without a bound 1.2 GB."""
    _outlet = pylsl.StreamOutlet(pylsl.StreamInfo("fast", "EEG", 1, 1e5, "float32", "fast-id"))
    before = psutil.Process().memory_info().rss
    with recorder_here(monkeypatch, tmp_path / "fast.xdf"):
        assert psutil.Process().memory_info().rss - before < 400e6


SLOW_TO_ANSWER = """
import time
import pylsl
outlet = pylsl.StreamOutlet(pylsl.StreamInfo("held", "EEG", 1, 0.0, "float32", "held-id"))
print("up", flush=True)
while True:
    outlet.push_sample([1.0])
    time.sleep(0.05)
"""


def test_a_stream_that_answers_late_is_recorded_from_then_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(receiver, "_OPEN_S", 1.0)
    open_ = ReceivedStream.open
    file = tmp_path / "held.xdf"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("other", "EEG", 1, 0.0, "float32", "other-id"))
    with subprocess.Popen([sys.executable, "-c", SLOW_TO_ANSWER], stdout=subprocess.PIPE) as sender:
        try:
            assert sender.stdout is not None
            assert sender.stdout.readline() == b"up\n"

            def open_held(stream: ReceivedStream, *arguments: Any) -> bool:
                if stream.title.startswith("held") and not stopped:
                    stopped.append(os.kill(sender.pid, signal.SIGSTOP))
                return open_(stream, *arguments)

            stopped: list[None] = []
            monkeypatch.setattr(ReceivedStream, "open", open_held)
            with recorder_here(monkeypatch, file) as said:
                assert any(each.startswith("held cannot be opened") for each in said)
                os.kill(sender.pid, signal.SIGCONT)
                wait_until(lambda: any("data collection for stream held" in e for e in said), "it")
                time.sleep(1.0)
                outlet.push_sample([2.0])
        finally:
            sender.kill()
    found = contents(file)
    assert set(found) == {"held", "other"}
    assert set(values_of(found["held"])) == {1.0}
    assert b"<sample_count>%d<" % len(found["held"].samples) in found["held"].footer


def start(unit: str) -> pylsl.StreamOutlet:
    """Start a stream whose samples are in this unit."""
    info = pylsl.StreamInfo("unit", "EEG", 1, 0.0, "float32", "unit-id")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "Fz")
    channel.append_child_value("unit", unit)
    return pylsl.StreamOutlet(info)


def test_what_comes_back_with_other_channels_is_another_stream(tmp_path: Path) -> None:
    file = tmp_path / "unit.xdf"
    outlet = start("microvolts")
    with own_recorder(file):
        log = file.with_suffix(".log")
        for number, unit, said in (0, "volts", "later than others"), (1, "microvolts", "goes on"):
            outlet.push_sample([float(number)])
            time.sleep(1.0)
            del outlet
            outlet = start(unit)
            wait_until(lambda said=said: said in log.read_text(), "the recorder goes on")
        outlet.push_sample([2.0])
        time.sleep(1.0)
    found = {each.header.units: values_of(each) for each in streams_of(file)}
    assert found == {("microvolts",): [0.0, 2.0], ("volts",): [1.0]}


@pytest.mark.usefixtures("only_own")
def test_what_changed_under_way_is_a_warning_of_the_verdict(
    sources: Sources, state: Path, tmp_path: Path
) -> None:
    outlet = start("microvolts")
    recording = LocalRecorder(state)
    begin(recording, request(tmp_path), sources.presence())
    said = RecorderFolder(state).output
    wait_until(lambda: "collection for stream unit" in said.read_text(), "it is recorded")
    del outlet
    _again = start("volts")
    wait_until(lambda: "later than others" in said.read_text(), "the recorder goes on")
    verdict = recording.stop().verdict
    told = [each for each in verdict.findings if each.code == "told"]
    assert {each.level for each in told} == {Level.WARNING}
    assert "has different channels now" in told[0].text
    assert verdict.colour is not Colour.GREEN


def test_it_looks_as_long_as_other_streams_come(tmp_path: Path) -> None:
    outlets: list[pylsl.StreamOutlet] = []

    def appear() -> None:
        for number in range(10):
            info = pylsl.StreamInfo(f"late {number}", "EEG", 1, 0, "float32", f"late-{number}")
            outlets.append(pylsl.StreamOutlet(info))
            time.sleep(0.6)

    appearing = threading.Thread(target=appear)
    appearing.start()
    file = tmp_path / "late.xdf"
    with own_recorder(file):
        appearing.join()
    assert len(contents(file)) == len(outlets) == 10
