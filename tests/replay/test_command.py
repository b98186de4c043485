"""The command: what it refuses, and how it ends."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import pylsl
import pytest

from biosensor_gateway.recording.bag.errors import BagError, BagReason
from biosensor_gateway.recording.contents.choice import Wish, choose
from biosensor_gateway.recording.export.exporter import Clock, Progress
from biosensor_gateway.recording.export.exporting import Task, export
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason, opened
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.replay import files
from tests.replay.playing import PATIENCE_S, playing

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
        assert "short.xdf is being played already" in second.said
        assert replay.interrupt() == 0
    assert [int(sample[1]) for sample, _ in pulled] == [0, 1, 2] * 2
    times = [stamp - (pulled[0][1] or 0.0) for _, stamp in pulled if stamp is not None]
    assert times == pytest.approx([0.0, 0.1, 0.3, 1.3, 1.4, 1.6], abs=1e-6)
    assert re.search(r"Ended at 0:00:0\d of 0:00:00 of round \d+\.\n\d+ samples", replay.said)


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
@pytest.mark.parametrize("wish", [Wish(begin="9:00:00"), Wish(["slow"], "0.2", "0.21")])
def test_where_nothing_is_nothing_is_played(long: Path, wish: Wish) -> None:
    with opened(long) as contents, pytest.raises(ReplayError) as caught:
        player = Player(choose(contents, wish), Order(), "hash")
        player.offer()
        player.run(threading.Event())
    assert caught.value.reason is ReplayReason.EMPTY


@pytest.mark.nightly
def test_a_bag_is_played_by_way_of_a_recording(long: Path, tmp_path: Path) -> None:
    exported = export(
        long, Task(["mcap"], Wish(["slow"], "", "20"), clock=Clock.LSL, output=tmp_path), _unwatched
    )
    (bag,) = [each.path for each in exported.written]
    with opened(bag) as contents:
        player = Player(choose(contents, Wish()), Order(speed=50.0), "hash")
        player.offer()
        player.run(threading.Event())
        assert contents.path.name == bag.name
        assert player.progress().sent == 80
    assert not contents.path.exists()


def _unwatched(_name: str, _seconds: float) -> Progress:
    return lambda _done: None
