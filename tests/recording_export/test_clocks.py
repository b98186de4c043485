"""Stamps on no LSL clock: said by every format, and moved nowhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Wish, choose, on_one_clock
from biosensor_gateway.recording.contents.opening import open_contents
from biosensor_gateway.recording.export.exporter import Missing
from biosensor_gateway.recording.replay import words
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.xdf.sender_clock import EXTRAPOLATED_S, SenderClock
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S
from tests.xdf import xdf_file as made

UNIX_S = 1.7e9
OFFSET_S, DRIFT = 40.0, 1e-5
COUNT = 50


def _offsets(number: int) -> bytes:
    """What the recorder measured of a clock that drifts."""
    return b"".join(
        made.clock_offset(number, BEGIN_S + each, OFFSET_S + DRIFT * each)
        for each in range(0, 60, 5)
    )


def _stream(number: int, name: str, first_s: float, kind: str = "EEG") -> bytes:
    stamps = first_s + np.arange(COUNT) / 10
    header = made.stream_header(number, name, kind=kind, rate=10.0)
    values = [[float(each)] for each in range(COUNT)]
    return header + made.samples(number, "float32", values, stamps.tolist()) + _offsets(number)


BOTH = made.xdf(_stream(1, "lsl", BEGIN_S), _stream(2, "unix", UNIX_S))
ALONE = made.xdf(_stream(2, "unix", UNIX_S))


def test_every_format_is_told_and_bids_leaves_it_out(exported: Exporting) -> None:
    outcome = exported(BOTH, "csv", "edf", "bids")
    (note,) = outcome.clock_notes
    assert note.startswith("unix: its stamps are 169999")
    assert "unix time" in note
    missing = {
        each.format: [note for note in each.notes if isinstance(note, Missing)]
        for each in outcome.written
    }
    assert {name: len(notes) for name, notes in missing.items()} == {"csv": 0, "edf": 0, "bids": 1}
    assert not outcome.is_whole
    assert exported(BOTH, "csv-long", wish=Wish(("lsl",))).clock_notes == ()


def test_alone_it_is_written_on_its_own_clock(exported: Exporting) -> None:
    (bids,) = exported(ALONE, "bids").written
    assert bids.is_whole
    assert list(bids.path.rglob("*_eeg.eeg"))


def test_a_stream_that_no_bag_can_hold_is_missing(exported: Exporting) -> None:
    late = made.xdf(_stream(1, "lsl", BEGIN_S), _stream(2, "late", 9.9e9))
    (bag,) = exported(late, "mcap").written
    assert [note for note in bag.notes if isinstance(note, Missing)] == [
        "50 samples of late are not in it: their stamp is no time of day"
    ]
    assert not bag.is_whole


def test_no_drift_is_taken_to_go_on_for_ever() -> None:
    clock = SenderClock([(BEGIN_S + each, OFFSET_S + DRIFT * each) for each in range(0, 60, 5)])
    last_s = BEGIN_S + 55
    stamps = np.array([0.0, BEGIN_S, last_s + 500, last_s + 5000, UNIX_S])
    added = clock.to_recorder(stamps) - stamps
    reach = EXTRAPOLATED_S * DRIFT
    assert added[1:3] == pytest.approx([OFFSET_S, OFFSET_S + 555 * DRIFT], abs=1e-6)
    assert np.abs(added[[0, 3, 4]] - OFFSET_S).max() <= reach + 60 * DRIFT + 1e-6
    np.testing.assert_allclose(clock.to_sender(clock.to_recorder(stamps)), stamps, atol=1e-6)


def test_a_replay_plays_the_others_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "both.xdf"
    path.write_bytes(BOTH)
    with open_contents(path) as contents:
        assert contents.end_s - contents.begin_s < 10
        player = Player(choose(contents, Wish()), Order(), "hash")
        assert [each.header.name for each in player.streams] == ["lsl"]
        assert player.progress().length_s < 10
        (sentence,) = words.left_out(player)
        assert sentence.startswith("warning: unix is not played, for its stamps are")
        alone = Player(choose(contents, Wish(streams=("unix",))), Order(), "hash")
        assert [each.header.name for each in alone.streams] == ["unix"]
        assert alone.progress().length_s == pytest.approx(4.9, abs=0.1)


def test_streams_on_one_clock_stay_together(tmp_path: Path) -> None:
    path = tmp_path / "good.xdf"
    path.write_bytes(made.xdf(_stream(1, "a", BEGIN_S), _stream(2, "b", BEGIN_S + 20)))
    with open_contents(path) as contents:
        chosen = choose(contents, Wish())
        assert on_one_clock(chosen) == (chosen, ())
