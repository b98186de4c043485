"""The command: what it refuses, and how it ends."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from biosensor_common.lsl.api_file import LslOverrides
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.agent.status_file import write_status
from biosensor_gateway.recording.bag.types import BagError, BagReason
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.exporter import Clock, Progress
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.replay.playback import elsewhere
from biosensor_gateway.recording.replay.player import (
    BIN_S,
    Lateness,
    Player,
    PlayOptions,
    Timeline,
    Track,
)
from biosensor_gateway.recording.replay.player_process import ReplayJob
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason, opened
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.replay import files
from tests.replay.files import PATIENCE_S, playing

FOREVER_S = 600.0


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return files.write(
        tmp_path_factory.mktemp("long") / "long.xdf",
        files.regular(1, "slow", 4.0, FOREVER_S, source_id="slow-id"),
        files.regular(2, "whole", 2.0, FOREVER_S, fmt="int64", source_id="whole-id"),
    )


@pytest.mark.nightly
def test_nothing_is_played_while_the_real_stream_is_there(long: Path) -> None:
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("slow", "Test", 2, 4.0, "float32", "slow-id"))
    with playing(long) as replay:
        code = replay.ended()
    assert code == 1
    (sentence,) = replay.said.splitlines()
    assert "the real stream slow is on the network" in sentence
    assert "--beside-live" in sentence
    with playing(long, "--streams", "whole") as replay:
        assert "1 stream" in replay.begun()
    with playing(long, "--beside-live") as replay:
        assert "2 streams" in replay.begun()
    del outlet


@pytest.mark.seam
def test_at_another_speed_rate_and_stamps_are_those_of_the_replay(long: Path) -> None:
    options = ("--speed", "50", "--until", "1:40", "--wait-for-consumers", "--as-original")
    with playing(long, *options, "--streams", "whole*") as replay:
        replay.begun()
        (found,) = pylsl.resolve_byprop("source_id", "whole-id", timeout=PATIENCE_S)
        inlet = pylsl.StreamInlet(found, recover=False)
        assert found.nominal_srate() == 100.0
        stamps: list[float] = []
        values: list[list[int]] = []
        while len(stamps) < 200:
            sample, stamp = inlet.pull_sample(PATIENCE_S)
            assert stamp is not None
            stamps.append(stamp)
            values.append(sample)
        assert replay.ended() == 0
    assert "at 50 times its speed" in replay.said
    assert stamps[-1] - stamps[0] == pytest.approx(199 / 100, abs=0.01)
    assert all(isinstance(each, int) for sample in values for each in sample)
    assert "200 samples were sent" in replay.said


@pytest.mark.nightly
def test_a_loop_begins_again_is_not_played_twice_and_ends_by_ctrl_c(tmp_path: Path) -> None:
    file = files.write(tmp_path / "short.xdf", files.texts(1, "marks", [0.0, 0.1, 0.3]))
    with playing(file, "--loop", "--wait-for-consumers") as replay:
        replay.begun()
        (found,) = pylsl.resolve_byprop("name", "marks", timeout=PATIENCE_S)
        inlet = pylsl.StreamInlet(found, recover=False)
        pulled = [inlet.pull_sample(PATIENCE_S) for _ in range(6)]
        with playing(file) as second:
            assert second.ended() == 1
        assert "short.xdf is already being played" in second.said
        assert replay.interrupt() == 0
    assert [int(sample[1]) for sample, _ in pulled] == [0, 1, 2] * 2
    times = [stamp - (pulled[0][1] or 0.0) for _, stamp in pulled if stamp is not None]
    assert times == pytest.approx([0.0, 0.1, 0.3, 1.3, 1.4, 1.6], abs=1e-6)
    assert re.search(r"Ended at 0:00:0\d of 0:00:00 of round \d+\.\n\d+ samples", replay.said)


# A player of the page that hangs as it closes, as liblsl does at times with an outlet.
CLOSING_NEVER_ENDS = """
import threading
from biosensor_gateway.recording.replay import player_process
player_process.playback.ended = lambda *_arguments, **_options: threading.Event().wait()
player_process.ENDS_WITHIN_S = 0.5
player_process.play_for_another()
"""


@pytest.mark.nightly
def test_a_player_that_hangs_ends_with_its_page_all_the_same(long: Path) -> None:
    job = ReplayJob(file=long).model_dump_json(exclude_unset=True).encode() + b"\n"
    command = [sys.executable, "-c", CLOSING_NEVER_ENDS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as player:
        assert player.stdin is not None
        assert player.stdout is not None
        player.stdin.write(job)
        player.stdin.flush()
        # It plays: this is what it tells its page.
        assert player.stdout.read(1)
        player.stdin.close()
        try:
            assert player.wait(PATIENCE_S) == 1
        finally:
            player.kill()


@pytest.mark.nightly
def test_a_wrong_wish_is_one_sentence(long: Path) -> None:
    with playing(long, "--streams", "none*") as replay:
        assert replay.ended() == 2
    (sentence,) = replay.said.splitlines()
    assert "there is no stream 'none*'" in sentence


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "notes.txt"
    other.write_text("no recording")
    for path, reason in (
        (other, RecordingReason.NOT_XDF),
        (tmp_path / "x.xdf", RecordingReason.NOT_FOUND),
    ):
        with pytest.raises(RecordingError) as caught, opened(path):
            pass
        assert caught.value.reason is reason
    with pytest.raises(BagError) as refused, opened(tmp_path):
        pass
    assert refused.value.reason is BagReason.NOT_A_BAG


@pytest.mark.nightly
@pytest.mark.parametrize(
    "selection", [Selection(begin="9:00:00"), Selection(["slow"], "0.2", "0.21")]
)
def test_where_nothing_is_nothing_is_played(long: Path, selection: Selection) -> None:
    with opened(long) as contents, pytest.raises(ReplayError) as caught:
        player = Player(choose(contents, selection), PlayOptions(), "hash")
        player.offer()
        player.run(threading.Event())
    assert caught.value.reason is ReplayReason.EMPTY


@pytest.mark.nightly
def test_a_bag_is_played_by_way_of_a_recording(long: Path, tmp_path: Path) -> None:
    exported = export(
        long,
        Task(["mcap"], Selection(["slow"], "", "20"), clock=Clock.LSL, output=tmp_path),
        _unwatched,
    )
    (bag,) = [each.path for each in exported.written]
    with opened(bag) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(speed=50.0), "hash")
        player.offer()
        player.run(threading.Event())
        assert contents.path.name == bag.name
        assert player.progress().sent == 80
    assert not contents.path.exists()


def _unwatched(_name: str, _seconds: float) -> Progress:
    return lambda _done: None


# When samples are due, and how late they are said to be.
SECONDS = st.floats(0, 1000, allow_subnormal=False)
TIMES = arrays(np.float64, st.integers(1, 30), elements=SECONDS)


class _Sent:
    """In place of an outlet; LSL's own is in the tests of the whole."""

    def __init__(self) -> None:
        self.values: list[int] = []
        self.stamps: list[float] = []

    def block(self, samples: Samples, stamps: NDArray[np.float64]) -> _Sent:
        self._block = samples, stamps
        return self

    def push(self, begin: int, end: int) -> None:
        samples, stamps = self._block
        self.values += np.asarray(samples.values)[begin:end, 0].tolist()
        self.stamps += stamps[begin:end].tolist()


@given(st.lists(TIMES, min_size=1, max_size=5), st.sampled_from([0.5, 1.0, 4.0]))
def test_every_sample_goes_out_once_in_the_order_of_the_file_and_never_before_its_time(
    chunks: list[NDArray[np.float64]], speed: float
) -> None:
    outlet, timeline = _Sent(), Timeline(5.0, 0.0, speed)
    numbers = iter(range(1000))
    blocks = [Samples(times, times, np.array([[next(numbers)] for _ in times])) for times in chunks]
    track = Track(outlet, iter(blocks))  # type: ignore[arg-type]
    while np.isfinite(track.due_s):
        due_s = track.due_s
        stamps = track.send(due_s, timeline)
        assert len(stamps) > 0
        # What runs back goes out late, with its own stamp.
        assert (stamps <= timeline.stamps(np.array([due_s]))[0]).all()
        assert track.due_s >= due_s
    times = np.concatenate(chunks)
    assert outlet.values == list(range(len(times)))
    assert outlet.stamps == timeline.stamps(times).tolist()


@given(SECONDS, SECONDS, st.floats(0.01, 100))
def test_a_timeline_leads_there_and_back(start_s: float, begin_s: float, speed: float) -> None:
    timeline = Timeline(start_s, begin_s, speed)
    stamps = timeline.stamps(np.array([begin_s, begin_s + 10.0]))
    assert stamps.tolist() == pytest.approx([start_s, start_s + 10.0 / speed])
    assert timeline.recorded(float(stamps[1])) == pytest.approx(begin_s + 10.0, abs=1e-6)


@given(arrays(np.float64, st.integers(1, 3000), elements=st.floats(0, 0.5)))
def test_lateness_is_told_to_a_tenth_of_a_millisecond(late: NDArray[np.float64]) -> None:
    account = Lateness()
    for at in range(0, len(late), 2):
        account.add(100.0, 100.0 - late[at : at + 2])
    assert account.most_s == pytest.approx(late.max(), abs=1e-9)
    for percent in (50, 99):
        told_s = account.percentile_s(percent)
        exact_s = np.sort(late)[int(np.ceil(len(late) * percent / 100)) - 1]
        assert exact_s - 1e-9 <= told_s <= exact_s + BIN_S + 1e-9


def test_of_nothing_there_is_no_lateness() -> None:
    assert Lateness().percentile_s(99) == 0.0


def test_a_replay_beside_an_agent_of_another_lsl_session_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    assert not list(elsewhere(LslOverrides("lab8")))
    write_status(tmp_path, AgentStatus(session="lab7", written=time.time()).model_dump())
    assert not list(elsewhere(LslOverrides("lab7")))
    (sentence,) = elsewhere(LslOverrides("lab8"))
    assert "played in the LSL session lab8" in sentence
    assert "agent sends in lab7" in sentence
