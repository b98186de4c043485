"""LabRecorder is killed in the middle of a recording, and what it wrote is salvaged."""

from __future__ import annotations

import subprocess
import threading
import time
import uuid
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome, salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import judge
from tests.rigs.lab_recorder import PROGRAM
from tests.xdf.checking import load_by_pyxdf

pytestmark = pytest.mark.nightly

RATE_HZ, PER_PUSH, PUSH_S = 100, 25, 0.25
# Clock offsets come every 5 s, boundaries every 10 s, and the file grows by blocks of 8 KiB.
ENOUGH_BYTES = 40_000
DEADLINE_S = 60.0
NAME = uuid.uuid4().hex[:8]
FAST, EVENTS = f"fast-{NAME}", f"events-{NAME}"


def _push(stop: threading.Event) -> None:
    fast = pylsl.StreamOutlet(pylsl.StreamInfo(FAST, "Test", 2, RATE_HZ, "double64", FAST))
    events = pylsl.StreamOutlet(pylsl.StreamInfo(EVENTS, "Markers", 1, 0, "string", EVENTS))
    begin, step = pylsl.local_clock(), 0
    while not stop.wait(max(0.0, begin + step * PUSH_S - pylsl.local_clock())):
        first = step * PER_PUSH
        # One stamp for all: LabRecorder leaves out those of the others.
        values = [[float(k), -float(k)] for k in range(first, first + PER_PUSH)]
        fast.push_chunk(values, begin + (first + PER_PUSH - 1) / RATE_HZ)
        events.push_sample([f"event {step}"], begin + step * PUSH_S)
        step += 1
    del fast, events


@contextmanager
def _outlets() -> Generator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=_push, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _record_and_kill(path: Path) -> None:
    command = [PROGRAM, str(path), f"name='{FAST}'", f"name='{EVENTS}'"]
    deadline = time.monotonic() + DEADLINE_S
    while not path.exists() or path.stat().st_size < ENOUGH_BYTES:
        # It ends at once if it has not found both.
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as recorder:
            while recorder.poll() is None and _is_small(path):
                assert time.monotonic() < deadline, "nothing was recorded"
                time.sleep(0.1)
            recorder.kill()


def _is_small(path: Path) -> bool:
    return not path.exists() or path.stat().st_size < ENOUGH_BYTES


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("killed") / "study.xdf"
    with _outlets():
        _record_and_kill(path)
    return path


@pytest.fixture(scope="module")
def outcome(killed: Path) -> Outcome:
    return salvage(killed, salvaged_path(killed))


def _loaded(path: Path) -> dict[str, dict[str, Any]]:
    return {stream["info"]["name"][0]: stream for stream in load_by_pyxdf(path)}


@pytest.mark.seam
def test_all_that_can_be_read_is_kept(killed: Path, outcome: Outcome) -> None:
    before = {each.header.name: each for each in read_recording(killed).streams}
    assert outcome.written is not None
    loaded = _loaded(outcome.written)
    assert set(loaded) == {FAST, EVENTS}
    for name, stream in loaded.items():
        held = before[name]
        assert stream["time_stamps"] == pytest.approx(held.stamps, abs=1e-9, rel=0)
        assert stream["clock_times"] == [time for time, _ in held.clock_offsets]
        assert stream["footer"]["info"]["sample_count"] == [str(held.sample_count)]
        assert before[name].footer is None


def test_no_sample_is_missing_up_to_the_kill(outcome: Outcome) -> None:
    assert outcome.written is not None
    fast = _loaded(outcome.written)[FAST]["time_series"]
    first = int(fast[0, 0])
    assert len(fast) > 1000
    assert fast.tolist() == [[float(k), -float(k)] for k in range(first, first + len(fast))]


def test_the_result_is_accepted(outcome: Outcome) -> None:
    assert outcome.written is not None
    report = judge(read_recording(outcome.written))
    assert report.is_good, report.findings
    assert not report.can_be_salvaged


def test_behind_a_damage_in_the_middle_values_keep_their_times(
    killed: Path, outcome: Outcome, tmp_path: Path
) -> None:
    content = bytearray(killed.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 200] = bytes(200)
    path = tmp_path / "damaged.xdf"
    path.write_bytes(content)
    assert outcome.written is not None
    whole = _loaded(outcome.written)[FAST]
    stamps = dict(zip(whole["time_series"][:, 0].tolist(), whole["time_stamps"], strict=True))
    damaged = salvage(path, salvaged_path(path))
    assert damaged.written is not None
    kept = _loaded(damaged.written)[FAST]
    values = kept["time_series"][:, 0].tolist()
    assert 0 < len(stamps) - len(values) < 3 * RATE_HZ
    assert [stamps[value] for value in values] == pytest.approx(kept["time_stamps"], abs=1e-3)
