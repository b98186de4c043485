"""Odd recordings as a replay and by way of a bag: all is there, or it is said what is not."""

from __future__ import annotations

import csv
import gzip
import math
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from numpy.typing import NDArray

from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import Replay
from biosensor_gateway.features.offline import compute
from biosensor_gateway.recording.bag.conversion import import_bag
from biosensor_gateway.recording.bag.types import BagError, BagReason
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.replay import playback
from biosensor_gateway.recording.replay.player import Player, PlayOptions, Timeline, Track
from biosensor_gateway.recording.replay.source import ReplayError, opened
from biosensor_gateway.recording.replay.stream_outlet import played_info
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.salvage.outcome import salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import check
from tests.recording_export import bids_shapes, odd_shapes
from tests.xdf import xdf_file as made
from tests.xdf.checking import read

FILES = odd_shapes.files()


class _Sent:
    """In place of an outlet; LSL's own is in the tests of replays."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def block(self, samples: Samples, _stamps: NDArray[np.float64]) -> _Sent:
        self._samples = samples
        return self

    def push(self, begin: int, end: int) -> None:
        self.times += self._samples.times[begin:end].tolist()


def _written(shape: str, folder: Path) -> Path:
    name, data = FILES[shape]
    path = folder / name
    path.write_bytes(data)
    return path


def _played(player: Player) -> list[int]:
    """Play without waiting; return how many samples of each stream were sent."""
    sent = [_Sent() for _ in player.streams]
    pairs = zip(sent, player.streams, strict=True)
    tracks = [Track(each, player.samples(stream)) for each, stream in pairs]  # type: ignore[arg-type]
    timeline = Timeline(0.0, player.begin_s, 1.0)
    while tracks and (track := min(tracks, key=lambda each: each.due_s)).due_s < math.inf:
        track.send(track.due_s, timeline)
    for each, stream in zip(sent, player.streams, strict=True):
        times = [time for block in player.samples(stream) for time in block.times.tolist()]
        assert each.times == times
    return [len(each.times) for each in sent]


@pytest.mark.parametrize("shape", FILES)
def test_a_replay_sends_each_sample_or_says_why_not(shape: str, tmp_path: Path) -> None:
    path = _written(shape, tmp_path)
    try:
        with opened(path) as contents:
            player = Player(choose(contents, Selection()), PlayOptions(), "hash")
            said = [*playback.damaged(player.damages), *playback.left_out(player)]
            counts = _played(player)
            for stream, source_id in zip(player.streams, player.own_ids, strict=True):
                _is_offered(stream, source_id)
            held = {each.number: each.sample_count for each in contents.streams}
            lacking = [
                stream.header.name
                for stream, count in zip(player.streams, counts, strict=True)
                if count < held[stream.number]
            ] + [each.header.name for each in player.left_out]
            for name in lacking:
                assert any(name in sentence for sentence in said), (name, said)
            assert player.is_whole == (not lacking and not player.damages)
    except (RecordingError, ReplayError) as error:
        assert str(error).strip()


def _is_offered(stream: Stream, source_id: str) -> None:
    """See that LSL takes the header."""
    header = stream.header
    replay = Replay("file.xdf", source_id, header.rate, 1.0, 0.0)
    info = played_info(header, source_id, replay)
    assert info.name() == (header.name or "nameless")
    assert info.channel_count() == header.channel_count
    assert info.nominal_srate() == header.rate


def _exported(path: Path) -> Outcome:
    return export(path, Task(["mcap"], Selection()), lambda _name, _s: lambda _done: None)


Content = dict[str, tuple[list[float], list[str]]]


def _content(path: Path) -> Content:
    """Times and values of each stream, in the order of time."""
    found: Content = {}
    with open_contents(path) as contents:
        for stream in contents.streams:
            rows = [
                (time, repr(tuple(row)))
                for block in stream.blocks()
                for time, row in zip(
                    block.times.tolist(),
                    block.values if isinstance(block.values, list) else block.values.tolist(),
                    strict=True,
                )
            ]
            # Of one time, a bag may have the samples in another order.
            rows.sort(key=lambda each: (round(each[0], 5), each[1]))
            key = f"{stream.number} {stream.header.name}"
            found[key] = [time for time, _ in rows], [row for _, row in rows]
    return found


@pytest.mark.parametrize("shape", FILES)
def test_by_way_of_a_bag_each_sample_comes_back_or_it_is_said(shape: str, tmp_path: Path) -> None:
    path = _written(shape, tmp_path)
    try:
        outcome = _exported(path)
    except RecordingError as error:
        assert str(error).strip()
        return
    (bag,) = outcome.written
    notes = [*bag.notes, *outcome.clock_notes]
    again = tmp_path / "again.xdf"
    imported = import_bag(bag.path, again)
    assert not imported.damages
    before, after = _content(path), _content(again)
    assert len(after) == len(before)
    for (name, (times, values)), (told_times, told_values) in zip(
        before.items(), after.values(), strict=True
    ):
        bare = name.partition(" ")[2]
        if len(told_times) < len(times):
            assert any(bare in note for note in notes), (name, notes)
            assert not outcome.is_whole
            continue
        assert told_times == pytest.approx(times, abs=2e-6)
        assert told_values == values


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        ("a clock that was set to the date", "clock-reset"),
        ("a clock that was set to the date, and stamps that were not", "clock-reset"),
        ("clock offsets of years", "unused-offsets"),
        ("clock offsets of years from the middle on", "unused-offsets"),
        ("clock offsets of years before", "unused-offsets"),
        ("one clock offset of years", "unused-offsets"),
    ],
)
def test_a_clock_that_is_off_by_years_moves_no_sample_and_is_told(
    shape: str, told: str, tmp_path: Path
) -> None:
    path = _written(shape, tmp_path)
    (times, _), *_ = _content(path).values()
    expected = odd_shapes.BEGIN_S + np.arange(odd_shapes.COUNT) / odd_shapes.RATE
    assert times == pytest.approx(expected.tolist(), abs=2e-3)
    findings = check(path).findings
    assert [each.level for each in findings if each.code == told] == [Level.WARNING]
    if told == "unused-offsets":
        outcome = _exported(path)
        computed = compute(path, tmp_path / "features.csv")
        for notes in (outcome.clock_notes, computed.remarks):
            assert any("not used" in note and note.startswith("ecg: ") for note in notes), notes


def test_a_replay_says_what_it_does_with_time_that_steps_back(tmp_path: Path) -> None:
    path = _written("a clock that began again, unmeasured", tmp_path)
    with opened(path) as contents:
        (sentence,) = playback.left_out(
            Player(choose(contents, Selection()), PlayOptions(), "hash")
        )
    assert sentence.startswith(
        "warning: ecg: its time steps back once; the following samples are sent"
    )


def test_a_bag_says_that_it_has_another_order(tmp_path: Path) -> None:
    path = _written("markers in no order", tmp_path)
    (bag,) = _exported(path).written
    assert any("so 2 of its samples come earlier in the bag" in note for note in bag.notes)


def test_times_before_0_are_moved_in_a_bag_and_come_back(tmp_path: Path) -> None:
    path = _written("stamps from before 0", tmp_path)
    (bag,) = _exported(path).written
    assert any("moved by 10 s, because ROS has no time before 0" in note for note in bag.notes)
    import_bag(bag.path, tmp_path / "again.xdf")
    again = read((tmp_path / "again.xdf").read_bytes())
    assert [each.sample_count for each in again.streams] == [odd_shapes.COUNT, 3]


def test_a_name_too_long_for_what_is_made_of_it_is_no_fault_of_the_recording(
    tmp_path: Path,
) -> None:
    path = tmp_path / f"{'x' * 245}.xdf"
    path.write_bytes(FILES["cut off"][1])
    for is_salvaged in (False, True):
        with pytest.raises(RecordingError) as caught:
            _ = salvage(path, salvaged_path(path)) if is_salvaged else _exported(path)
        assert caught.value.reason is RecordingReason.UNWRITABLE
        assert str(caught.value).startswith("cannot write ")
        assert str(caught.value).endswith("; choose a shorter name")
    assert list(tmp_path.iterdir()) == [path]


def test_no_sentence_about_a_stream_without_a_name_begins_with_nothing(tmp_path: Path) -> None:
    # Its stamps are unix time, and one of them is missing, so that there is something to say.
    stamps = odd_shapes.BEGIN_S + 1.7e9 + np.arange(odd_shapes.COUNT) / odd_shapes.RATE
    stamps[7] = np.nan
    path = tmp_path / "rec.xdf"
    path.write_bytes(odd_shapes.made.xdf(*odd_shapes.nameless(stamps)))
    formats = ("csv", "edf", "kubios", "bids", "mcap", "ledalab")
    outcome = export(path, Task(formats, Selection()), lambda _name, _s: lambda _done: None)
    judged = check(path)
    with opened(path) as contents:
        chosen = choose(contents, Selection())
        played = list(playback.left_out(Player(chosen, PlayOptions(), "hash")))
    sentences = [
        *(note for each in outcome.written for note in each.notes),
        *(each.why for each in outcome.without),
        *outcome.clock_notes,
        *(f"{each.stream}: {each.text}" for each in judged.findings),
        *compute(path, tmp_path / "features.csv").remarks,
        *played,
    ]
    assert sum("nameless ECG" in each for each in sentences) > 6
    for each in sentences:
        assert not each.startswith(":"), each
        assert "''" not in each, each
        assert ": :" not in each, each


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
@pytest.mark.parametrize("is_bag", [False, True])
def test_no_room_for_temporary_files_is_no_fault_of_what_is_packed(
    is_bag: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource  # noqa: PLC0415 - not on Windows

    plain = tmp_path / "rec.xdf"
    plain.write_bytes(odd_shapes.made.xdf(*odd_shapes.nameless(np.arange(1e5) / 130)))
    pack = zstd.compress if is_bag else gzip.compress
    path = tmp_path / ("a_0.mcap.zstd" if is_bag else "rec.xdfz")
    path.write_bytes(pack(plain.read_bytes()))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # A write beyond it fails, as one to a disk that is full.
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises((RecordingError, BagError)) as caught:
            _ = import_bag(path, tmp_path / "again.xdf") if is_bag else check(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.reason in {RecordingReason.UNWRITABLE, BagReason.UNWRITABLE}
    assert str(caught.value).startswith(f"cannot write temporary files to {tmp_path}/temporary: ")
    assert str(caught.value).endswith("; the variable TMPDIR (on Windows TEMP) names the folder")
    assert not list((tmp_path / "temporary").iterdir())


def test_markers_on_another_clock_are_events_of_a_data_set(tmp_path: Path) -> None:
    """Their onsets are on that clock, which is said; left out, they would be lost."""
    path = _written("markers on a clock of their own", tmp_path)
    outcome = export(path, Task(["bids"], Selection()), lambda _name, _s: lambda _done: None)
    assert not outcome.is_whole
    assert any("away from the LSL clock" in each for each in outcome.clock_notes)
    (table,) = outcome.written[0].path.rglob("*_events.tsv")
    rows = [line.split("\t") for line in table.read_text().splitlines()[1:]]
    assert [(float(row[0]), row[2]) for row in rows] == [
        (3.5 - 501_000, "cut 1"),
        (9.25 - 501_000, "cut 2"),
    ]


def test_a_quote_in_a_marker_hides_none_behind_it(tmp_path: Path) -> None:
    path = _written("odd texts", tmp_path)
    outcome = export(path, Task(["bids"], Selection()), lambda _name, _s: lambda _done: None)
    (table,) = outcome.written[0].path.rglob("*_events.tsv")
    with table.open(encoding="utf-8", newline="") as file:
        told = [row["value"] for row in csv.DictReader(file, delimiter="\t")]
    assert len(told) == len(odd_shapes.ODD_TEXTS)
    assert '"not closed' in told


def test_more_channels_than_others_open_are_said(tmp_path: Path) -> None:
    path = tmp_path / "many.xdf"
    header = made.stream_header(1, "grid", kind="EMG", rate=10.0, channels=640, fmt="int16")
    samples = made.samples(
        1, "int16", [[each] * 640 for each in range(20)], [1.0 + each / 10 for each in range(20)]
    )
    path.write_bytes(made.xdf(header, samples, made.footer(1, 20)))
    outcome = export(path, Task(["edf"], Selection()), lambda _name, _s: lambda _done: None)
    assert any("cannot open files of 640" in each for each in outcome.written[0].notes)


def test_samples_that_a_data_set_leaves_out_are_missing(tmp_path: Path) -> None:
    path = _written("stamps beyond all clocks", tmp_path)
    outcome = export(path, Task(["bids"], Selection()), lambda _name, _s: lambda _done: None)
    assert not outcome.is_whole
    assert any("1600 samples" in each for each in outcome.written[0].notes)


def test_a_replay_begins_with_the_signals_though_intervals_are_of_before(tmp_path: Path) -> None:
    strap = DeviceIdentity("polar_verity_sense", "A1", "P01")
    agent = DeviceIdentity("gateway", "lab-pc")
    path = tmp_path / "rec.xdf"
    ecg, beats = (
        bids_shapes.times(1300, 130.0),
        bids_shapes.times(30, 1.0, bids_shapes.BEGIN_S - 20.0),
    )
    mark = bids_shapes.marker(1, "baseline", bids_shapes.BEGIN_S - 5.0)
    parts = {
        "signal": bids_shapes.ours(
            1, strap, "ppg", bids_shapes.numbers(1300), ecg, rate=130.0, kind="PPG"
        ),
        "intervals": bids_shapes.ours(
            2, strap, "ibi", bids_shapes.numbers(30), beats, [("RR", "s")], kind="RR"
        ),
        "markers": bids_shapes.ours(
            3, agent, "markers", [mark], [bids_shapes.BEGIN_S - 5.0], fmt="string", kind="Markers"
        ),
    }
    for names, begin_s in [
        (("signal", "intervals"), bids_shapes.BEGIN_S),
        (("signal", "intervals", "markers"), bids_shapes.BEGIN_S),
        (("intervals",), bids_shapes.BEGIN_S - 20.0),
    ]:
        path.write_bytes(made.xdf(*(parts[each] for each in names)))
        with opened(path) as contents:
            player = Player(choose(contents, Selection()), PlayOptions(), "hash")
            assert player.begin_s == pytest.approx(begin_s)
            sizes = {"signal": 1300, "intervals": 30, "markers": 1}
            assert _played(player) == [sizes[each] for each in names]


@pytest.mark.parametrize("shape", ["stamps beyond all clocks", "stamps as large as numbers are"])
def test_no_sentence_has_hundreds_of_digits(shape: str, tmp_path: Path) -> None:
    path = _written(shape, tmp_path)
    formats = ("csv", "edf", "kubios", "bids", "mcap")
    outcome = export(path, Task(formats, Selection()), lambda _name, _s: lambda _done: None)
    sentences = [
        *(note for each in outcome.written for note in each.notes),
        *outcome.clock_notes,
        *(each.text for each in check(path).findings),
        *compute(path, tmp_path / "features.csv").remarks,
    ]
    for each in sentences:
        assert not re.search(r"\d{30}", each), each


FAR_S = 200_000.0


@pytest.mark.parametrize("chunk", [1, 100, odd_shapes.COUNT])
@pytest.mark.parametrize(
    "far",
    [
        {0: FAR_S},
        {0: -FAR_S},
        {1300: FAR_S},
        {1350: 5.0},
        {1399: FAR_S, 1400: FAR_S, 1401: FAR_S},
        {500: FAR_S, 1700: -800.0},
        {odd_shapes.COUNT - 1: FAR_S},
    ],
)
def test_nothing_waits_for_the_time_of_a_stamp_far_from_all_others(
    far: dict[int, float], chunk: int, tmp_path: Path
) -> None:
    stamps = odd_shapes.BEGIN_S + np.arange(odd_shapes.COUNT) / odd_shapes.RATE
    expected = stamps.copy()
    for at, away_s in far.items():
        stamps[at] += away_s
    path = tmp_path / "rec.xdf"
    path.write_bytes(made.xdf(*odd_shapes.nameless(stamps, chunk=chunk)))
    with opened(path) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        (told,) = (each for each in playback.left_out(player) if "far from those" in each)
        assert sorted(player.streams[0].stray) == sorted(far)
        times = np.concatenate([each.times for each in player.samples(player.streams[0])])
    period_s = 1 / odd_shapes.RATE
    assert times == pytest.approx(expected.tolist(), abs=1.01 * period_s)
    assert player.end_s - player.begin_s == pytest.approx(20.0, abs=2.1 * period_s)
    assert f"{len(far)} stamp" in told
