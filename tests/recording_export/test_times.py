"""The times of an export: as recorded or even, on which clock, in which runs."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from numpy.typing import NDArray

from biosensor_gateway.features.offline import compute
from biosensor_gateway.recording.contents.choice import Selection, choose, on_one_clock
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export import runs
from biosensor_gateway.recording.export.exporter import Missing, Times
from biosensor_gateway.recording.export.outcome import Outcome, Written
from biosensor_gateway.recording.replay import playback
from biosensor_gateway.recording.replay.player import Player, PlayOptions
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.pace import Cuts
from biosensor_gateway.recording.xdf.sender_clock import EXTRAPOLATED_S, SenderClock
from tests.recording_export.bids_shapes import EEG_VALUES, eeg
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S, ecg_values, study
from tests.xdf import xdf_file as made
from tests.xdf.checking import check

# Times as recorded, which is the default, and even ones; what becomes of gaps with each.

ECG = "P1-polar_h10-U1-ecg"
RATE = 130.0
# The ECG of the study stops for 5 s behind 1300 samples.
BEFORE, MISSING = 1300, 650
FORMATS = ("csv", "csv-long", "edf", "kubios", "ledalab", "bids", "mcap")


def _of(outcome: Outcome, name: str) -> Written:
    (found,) = (each for each in outcome.written if each.format == name)
    return found


def _rows(path: Path, delimiter: str = ",") -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter=delimiter))


def test_recorded_times_are_the_default(exported: Exporting, tmp_path: Path) -> None:
    found: list[dict[str, bytes]] = []
    for place, options in (("a", {}), ("b", {"times": Times.RECORDED})):
        folder = tmp_path / place
        folder.mkdir()
        exported(study(), *FORMATS, output=folder, **options)
        found.append(
            {
                str(path.relative_to(folder)): path.read_bytes()
                for path in folder.rglob("*")
                if path.is_file()
            }
        )
    assert found[0] == found[1]
    assert any("ecg_run2.bdf" in name for name in found[0])


def test_in_edf_a_gap_is_an_event_and_the_file_goes_on(exported: Exporting) -> None:
    written = _of(exported(study(), "edf", times=Times.EVEN), "edf")
    file = read_bdf(written.path / f"{ECG}.bdf")
    (signal,) = file.signals
    assert signal.sampling_frequency == RATE
    data, values = signal.data, ecg_values(2600)[:, 0]
    np.testing.assert_allclose(data[:BEFORE], values[:BEFORE], atol=1e-3)
    # No value that was measured stands in the gap.
    gap_values = data[BEFORE : BEFORE + MISSING]
    np.testing.assert_allclose(gap_values, signal.physical_min, atol=1e-3)
    np.testing.assert_allclose(data[BEFORE + MISSING : 2600 + MISSING], values[BEFORE:], atol=1e-3)
    (gap,) = (each for each in file.annotations if each.text == "BAD_gap")
    assert (gap.onset, gap.duration) == (pytest.approx(10.0), pytest.approx(5.0))
    assert any("1 gap, about 650 samples missing" in note for note in written.notes)


def test_for_kubios_each_missing_sample_is_nan_and_the_gap_is_listed(exported: Exporting) -> None:
    written = _of(exported(study(), "kubios", times=Times.EVEN), "kubios")
    lines = np.array((written.path / f"{ECG}.txt").read_text().split(), float)
    assert np.flatnonzero(np.isnan(lines)).tolist() == list(range(BEFORE, BEFORE + MISSING))
    measured = lines[~np.isnan(lines)].astype(np.float32)
    assert measured.tolist() == ecg_values(2600)[:, 0].tolist()
    (gap,) = _rows(written.path / f"{ECG}_gaps.csv")
    assert gap == {
        "first_line": str(BEFORE + 1),
        "seconds": "10.0",
        "duration": "5.0",
        "event": "BAD_gap",
    }


def test_in_tables_a_gap_is_an_event(exported: Exporting) -> None:
    outcome = exported(study(), "csv", "csv-long", "ledalab", times=Times.EVEN)
    events = _rows(_of(outcome, "csv").path / "all_markers.csv")
    (gap,) = (each for each in events if each["marker"] == "BAD_gap")
    assert float(gap["seconds"]) == pytest.approx(10.0)
    assert (gap["stream"], gap["participant"]) == (ECG, "P1")
    assert "650 samples" in gap["note"]
    assert len(_rows(_of(outcome, "csv").path / f"{ECG}.csv")) == 2600
    (line,) = (each for each in _rows(_of(outcome, "csv-long").path) if each["text"] == "BAD_gap")
    assert float(line["value"]) == pytest.approx(5.0)


def test_in_bids_a_gap_is_an_event_of_its_length(exported: Exporting) -> None:
    root = _of(exported(study(), "bids", times=Times.EVEN), "bids").path
    (table,) = root.glob("sub-P1/beh/*events.tsv")
    (gap,) = (each for each in _rows(table, "\t") if each["trial_type"] == "BAD_gap")
    assert (float(gap["onset"]), float(gap["duration"])) == (
        pytest.approx(10.0),
        pytest.approx(5.0),
    )
    assert gap["stream"] == ECG
    others = (each for each in _rows(table, "\t") if each["trial_type"] != "BAD_gap")
    assert {each["duration"] for each in others} == {"n/a"}


def test_a_bag_has_recorded_times_and_says_so(exported: Exporting) -> None:
    assert any("recorded times" in note for note in _of(
        exported(study(), "mcap", times=Times.EVEN), "mcap"
    ).notes)  # fmt: skip


REAL_HZ = 129.8


def _stamped(
    burst: int, jitter_s: float, lost_at: int = 0, lost: int = 0, bursts: int = 80
) -> NDArray[np.float64]:
    """Stamps of a sender that stamps packets when they come, of which some may be lost."""
    measured = BEGIN_S + np.arange(burst * bursts) / REAL_HZ
    stamps = measured[np.minimum(np.arange(len(measured)) // burst * burst + burst - 1, 10**9)]
    late = np.random.default_rng(burst).uniform(0, jitter_s, bursts)
    stamps = np.maximum.accumulate(stamps + np.repeat(late, burst))
    return np.delete(stamps, slice(lost_at, lost_at + lost))


def _strap(stamps: NDArray[np.float64]) -> bytes:
    values = np.arange(len(stamps), dtype=np.float32)[:, np.newaxis]
    return made.xdf(
        made.stream_header(1, "strap", kind="ECG", rate=RATE),
        made.samples(1, "float32", values.tolist(), stamps.tolist()),
    )


def test_even_times_lie_on_a_line_and_how_far_they_moved_is_said(exported: Exporting) -> None:
    written = _of(exported(_strap(_stamped(73, 0.0)), "csv", times=Times.EVEN), "csv")
    times = [float(each["lsl_time"]) for each in _rows(written.path / "strap.csv")]
    np.testing.assert_allclose(np.diff(times), 1 / REAL_HZ, rtol=1e-3)
    # A packet is stamped when it comes, which is when its last sample was measured.
    np.testing.assert_allclose(times, BEGIN_S + np.arange(len(times)) / REAL_HZ, atol=2e-3)
    (note,) = (each for each in written.notes if "even times" in each)
    assert float(note.split("at most ")[1].split(" ms")[0]) == pytest.approx(
        72 / REAL_HZ * 1e3, rel=0.01
    )


def _late_first(count: int, late_s: float) -> NDArray[np.float64]:
    stamps = BEGIN_S + np.arange(5200) / REAL_HZ
    stamps[:count] += late_s
    return stamps


def _stands_still(until: int, back_s: float = 0.0) -> NDArray[np.float64]:
    stamps = BEGIN_S + np.arange(5200) / REAL_HZ
    stamps[2000:until] = stamps[2000]
    stamps[until:] -= back_s
    return stamps


def _late_burst(late_s: float) -> NDArray[np.float64]:
    stamps = _stamped(73, 0.0)
    stamps[:73] += late_s
    return stamps


TIMED = {
    "bursts": _stamped(73, 0.0),
    "a first burst that is late": _late_burst(0.9),
    "a first burst that is very late": _late_burst(2.0),
    "a first sample that is late": _late_first(1, 0.31),
    "a first packet that is late": _late_first(73, 0.91),
    "a clock that stands still for 10 s": _stands_still(3298),
    "a clock that stands still to the end": _stands_still(5200),
}


@pytest.mark.parametrize("times", Times)
@pytest.mark.parametrize("shape", TIMED)
def test_a_marker_stands_at_the_sample_that_was_measured_then(
    shape: str, times: Times, exported: Exporting
) -> None:
    stamps = TIMED[shape]
    at = 1500 + 17 * np.arange(3)
    markers = (
        made.stream_header(2, "told", kind="Markers", fmt="string"),
        made.samples(2, "string", [["m"]] * 3, (BEGIN_S + at / REAL_HZ).tolist()),
    )
    values = np.arange(len(stamps), dtype=np.float32)[:, np.newaxis].tolist()
    signal = (
        made.stream_header(1, "strap", kind="ECG", rate=RATE, source_id="a"),
        made.samples(1, "float32", values, stamps.tolist()),
    )
    outcome = exported(made.xdf(*signal, *markers), "edf", "bids", times=times)
    file = read_bdf(_of(outcome, "edf").path / "strap.bdf")
    told = [each.onset for each in file.annotations if each.text == "m"]
    rate_hz = file.signals[0].sampling_frequency
    assert np.array(told) * rate_hz == pytest.approx(at, abs=1)
    folder = _of(outcome, "bids").path
    (table,) = folder.rglob("*strap*_physio.tsv.gz")
    (sidecar,) = folder.rglob("*strap*_physio.json")
    (events,) = folder.rglob("*_events.tsv")
    onsets = [
        float(line.split("\t")[0]) for line in events.read_text().splitlines() if "\tm\t" in line
    ]
    about = json.loads(sidecar.read_text())
    rows = [line.split("\t") for line in gzip.decompress(table.read_bytes()).decode().splitlines()]
    begin_s, rate = float(about["StartTime"]), float(about["SamplingFrequency"])
    place = [round((each - begin_s) * rate) for each in onsets]
    found = [float(rows[each][1]) for each in place]
    assert found == pytest.approx(at, abs=5)


@pytest.mark.parametrize(
    ("until", "back_s", "files"), [(3298, 0.0, 1), (5200, 0.0, 1), (3298, 10.0, 2)]
)
def test_a_clock_that_stands_still_is_told_and_nothing_is_lost(
    until: int, back_s: float, files: int, exported: Exporting
) -> None:
    content = _strap(_stands_still(until, back_s))
    report = check(content)
    found = [each for each in report.findings if each.code == "standstill"]
    assert [each.level for each in found] == [Level.ERROR]
    assert report.streams[0].figures.gaps.count == 0
    written = _of(exported(content, "edf"), "edf")
    assert len(list(written.path.glob("*.bdf"))) == files
    assert any("stood still" in each for each in written.notes)
    assert not any("missing" in each for each in written.notes)


@pytest.mark.parametrize("length", [40_000, 200_000])
def test_a_clock_may_stand_still_longer_than_what_is_looked_at_at_once(length: int) -> None:
    stamps = BEGIN_S + np.arange(300_000) / REAL_HZ
    stamps[50_000 : 50_000 + length] = stamps[50_000]
    cuts = Cuts(REAL_HZ, 65_536)
    for block in np.array_split(stamps, 77):
        cuts.take(block)
    cuts.end()
    assert cuts.pace is not None
    assert [(each.at, each.count) for each in cuts.pace.standstills] == [(50_000, length)]
    assert (cuts.numbers, cuts.holes) == ([], [])
    found = cuts.times(0, 0, len(stamps))
    assert found is not None
    np.testing.assert_allclose(found, BEGIN_S + np.arange(300_000) / REAL_HZ, atol=1e-3)


@pytest.mark.parametrize(("count", "late_s"), [(1, 0.3), (73, 0.9), (10, 0.05)])
def test_first_samples_that_are_late_are_told_as_such(count: int, late_s: float) -> None:
    found = {each.code: each for each in check(_strap(_late_first(count, late_s))).findings}
    assert found["late-first"].level is Level.WARNING
    assert "backwards" not in found


@pytest.mark.parametrize(("burst", "jitter_s"), [(1, 0.002), (8, 0.01), (25, 0.03), (73, 0.05)])
def test_a_hole_beyond_a_burst_and_three_times_the_jitter_is_told(
    burst: int, jitter_s: float, exported: Exporting, tmp_path: Path
) -> None:
    packets = int(np.ceil((burst / REAL_HZ + 3 * jitter_s) * REAL_HZ / burst))
    lost = packets * burst
    content = _strap(_stamped(burst, jitter_s, 40 * burst, lost))
    for times, files in ((Times.RECORDED, 2), (Times.EVEN, 1)):
        folder = tmp_path / times
        folder.mkdir()
        written = _of(exported(content, "edf", output=folder, times=times), "edf")
        assert len(list(written.path.glob("*.bdf"))) == files
        (note,) = (each for each in written.notes if "1 gap" in each)
        told = int(note.split("about ")[1].split(" ")[0])
        assert told == pytest.approx(lost, abs=1 + 3 * jitter_s * REAL_HZ)


def test_without_a_hole_none_is_told(exported: Exporting, tmp_path: Path) -> None:
    for times in Times:
        folder = tmp_path / times
        folder.mkdir()
        content = _strap(_stamped(25, 0.03))
        written = _of(exported(content, "edf", output=folder, times=times), "edf")
        assert not any("gap" in note for note in written.notes)
        assert len(list(written.path.glob("*.bdf"))) == 1


def test_a_step_back_begins_another_file_also_with_even_times(exported: Exporting) -> None:
    stamps = BEGIN_S + np.arange(2600) / RATE
    stamps[1300:] -= 5.0
    written = _of(exported(_strap(stamps), "edf", times=Times.EVEN), "edf")
    assert {each.name for each in written.path.iterdir()} >= {"strap_run1.bdf", "strap_run2.bdf"}


def test_a_stray_stamp_does_not_bend_the_line(exported: Exporting) -> None:
    stamps = BEGIN_S + np.arange(2600) / RATE
    stamps[1300] += 200_000.0
    written = _of(exported(_strap(stamps), "csv", times=Times.EVEN), "csv")
    times = [float(each["lsl_time"]) for each in _rows(written.path / "strap.csv")]
    np.testing.assert_allclose(times, BEGIN_S + np.arange(2600) / RATE, atol=1e-3)
    assert any("1 stamp is far from" in note for note in written.notes)


def test_eeg_goes_on_behind_a_gap_of_28_s(exported: Exporting) -> None:
    root = _of(exported(eeg(), "bids", times=Times.EVEN), "bids").path
    (file,) = root.rglob("*_eeg.eeg")
    values = np.frombuffer(file.read_bytes(), "<f4").reshape(-1, 2)
    assert values[~np.isnan(values).any(axis=1)].tobytes() == EEG_VALUES.tobytes()
    (table,) = root.rglob("eeg/*_events.tsv")
    gaps = [each for each in _rows(table, "\t") if each["trial_type"] == "BAD_gap"]
    assert [float(each["duration"]) for each in gaps] == pytest.approx([2.0, 28.0])
    sidecar = json.loads(file.with_suffix(".json").read_text())
    assert sidecar["RecordingType"] == "discontinuous"


# Stamps on no LSL clock: said by every format, and moved nowhere.
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
    samples = made.samples(number, "float32", values, stamps.tolist())
    return header + samples + _offsets(number) + made.footer(number, COUNT)


BOTH = made.xdf(_stream(1, "lsl", BEGIN_S), _stream(2, "unix", UNIX_S))
ALONE = made.xdf(_stream(2, "unix", UNIX_S))


def test_every_format_is_told_and_bids_leaves_it_out(exported: Exporting) -> None:
    outcome = exported(BOTH, "csv", "edf", "bids")
    (note,) = outcome.clock_notes
    assert note.startswith("unix: its timestamps are 169999")
    assert "unix time" in note
    missing = {
        each.format: [note for note in each.notes if isinstance(note, Missing)]
        for each in outcome.written
    }
    assert {name: len(notes) for name, notes in missing.items()} == {"csv": 0, "edf": 0, "bids": 1}
    assert not outcome.is_whole
    assert exported(BOTH, "csv-long", selection=Selection(("lsl",))).clock_notes == ()


def test_alone_it_is_written_on_its_own_clock(exported: Exporting) -> None:
    (bids,) = exported(ALONE, "bids").written
    assert bids.is_whole
    assert list(bids.path.rglob("*_eeg.eeg"))


def test_a_stream_that_no_bag_can_hold_is_missing(exported: Exporting) -> None:
    late = made.xdf(_stream(1, "lsl", BEGIN_S), _stream(2, "late", 9.9e9))
    (bag,) = exported(late, "mcap").written
    assert [note for note in bag.notes if isinstance(note, Missing)] == [
        "50 samples of late are not in it: their timestamp is not valid"
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


def _unix(part: slice, *, is_marker: bool) -> bytes:
    """A stream, or its markers, of which a part has Unix stamps."""
    stamps, moments = BEGIN_S + np.arange(5200) / RATE, BEGIN_S + 2.0 * np.arange(20)
    changed = moments if is_marker else stamps
    changed[part] += 1.7e9
    clock = (BEGIN_S, BEGIN_S + 40.0)
    texts = [[f"m{each}"] for each in range(20)]
    values = np.sin(np.arange(5200, dtype=np.float32))[:, np.newaxis].tolist()
    return made.xdf(
        made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="a"),
        made.samples(1, "float32", values, stamps.tolist()),
        made.offsets(1, clock),
        made.footer(1, 5200),
        made.stream_header(2, "told", kind="Markers", fmt="string", source_id="b"),
        made.samples(2, "string", texts, moments.tolist()),
        made.offsets(2, clock),
        made.footer(2, 20),
    )


@pytest.mark.parametrize(
    ("part", "is_marker"),
    [
        (slice(2600, None), False),
        (slice(None, 2600), False),
        (slice(2600, 3100), False),
        (slice(10, None), True),
        (slice(7, 8), True),
    ],
)
def test_stamps_that_are_of_another_clock_in_part_are_told_everywhere(
    part: slice, is_marker: bool, exported: Exporting, tmp_path: Path
) -> None:
    content = _unix(part, is_marker=is_marker)
    report = check(content)
    name = "told" if is_marker else "ecg"
    (found,) = (each for each in report.findings if each.code == "wrong-clock")
    assert (found.level, found.stream) == (Level.ERROR, name)
    assert "unix time" in found.text
    # Nothing was lost, and the recording is as long as it was.
    assert all(not each.figures.gaps.count for each in report.streams)
    assert 38.0 <= report.extent.length_s <= 40.0

    outcome = exported(content, "csv", "edf", "bids", "mcap")
    assert not outcome.is_whole
    assert any(each.startswith(f"{name}: ") and "unix" in each for each in outcome.clock_notes)
    assert len(_rows(_of(outcome, "csv").path / "ecg.csv")) == 5200
    files = sorted(_of(outcome, "edf").path.glob("*.bdf"))
    told = {note.text for each in files for note in read_bdf(each).annotations}
    assert {f"m{each}" for each in range(20)} <= told

    path = tmp_path / "rec.xdf"
    path.write_bytes(content)
    assert any("unix" in each for each in compute(path, tmp_path / "f.csv").remarks) != is_marker
    with open_contents(path) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        assert player.end_s - player.begin_s < 41
        assert not player.is_whole
        assert any("not played" in each for each in playback.left_out(player))
        played = [each for stream in player.streams for each in player.samples(stream)]
        assert max(float(each.times.max()) for each in played) < BEGIN_S + 41


def test_a_replay_plays_the_others_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "both.xdf"
    path.write_bytes(BOTH)
    with open_contents(path) as contents:
        # Its recorder went on for a while, as its clock offsets show, but not for 53 years.
        length_s = check(BOTH).extent.length_s
        assert 4.9 < length_s < 100
        assert contents.end_s - contents.begin_s == pytest.approx(length_s)
        player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        assert [each.header.name for each in player.streams] == ["lsl"]
        assert player.progress().length_s == pytest.approx(length_s)
        (sentence,) = playback.left_out(player)
        assert sentence.startswith("warning: unix is not played, because its timestamps are")
        alone = Player(choose(contents, Selection(streams=("unix",))), PlayOptions(), "hash")
        assert [each.header.name for each in alone.streams] == ["unix"]
        assert alone.progress().length_s == pytest.approx(4.9, abs=0.1)


def test_streams_on_one_clock_stay_together(tmp_path: Path) -> None:
    path = tmp_path / "good.xdf"
    path.write_bytes(made.xdf(_stream(1, "a", BEGIN_S), _stream(2, "b", BEGIN_S + 20)))
    with open_contents(path) as contents:
        chosen = choose(contents, Selection())
        assert on_one_clock(chosen) == (chosen, ())


# Runs of a stream do not depend on where its batches begin, and their files never clash.
RUN_HZ, RUN_LENGTH, CHUNK = 100.0, 60, 10
GAP_S = 5.0


def _with_runs(
    number: int, name: str, stamps: np.ndarray, first: float, kind: str = "ECG"
) -> bytes:
    """One whose values are counted from `first`, in chunks."""
    values = (first + np.arange(len(stamps), dtype=np.float32))[:, np.newaxis]
    chunks = [
        made.samples(
            number, "float32", values[at : at + CHUNK].tolist(), list(stamps[at : at + CHUNK])
        )
        for at in range(0, len(values), CHUNK)
    ]
    header = made.stream_header(number, name, kind=kind, rate=RUN_HZ, source_id=f"{name}{number}")
    return header + b"".join(chunks)


def _stamps(gap_at: int | None = None, step_s: float = GAP_S) -> np.ndarray:
    stamps = BEGIN_S + np.arange(RUN_LENGTH) / RUN_HZ
    if gap_at is not None:
        stamps[gap_at:] += step_s
    return stamps


def _kubios(outcome: Outcome) -> dict[str, list[float]]:
    (written,) = (each for each in outcome.written if each.format == "kubios")
    return {
        path.name: [float(each) for each in path.read_text().split()]
        for path in written.path.iterdir()
        if path.name != "README.txt"
    }


def _edf(outcome: Outcome) -> dict[str, list[float]]:
    (written,) = (each for each in outcome.written if each.format == "edf")
    return {
        path.name: np.round(read_bdf(path).signals[0].data).tolist()
        for path in written.path.iterdir()
        if path.name != "README.txt"
    }


@pytest.mark.parametrize("step_s", [GAP_S, -GAP_S])
@pytest.mark.parametrize("gap_at", [1, 9, 10, 19, 20, 21, 40, 59])
def test_a_gap_may_be_at_the_begin_of_a_batch(
    gap_at: int, step_s: float, exported: Exporting
) -> None:
    content = made.xdf(_with_runs(1, "a", _stamps(gap_at, step_s), 0))
    values = np.arange(RUN_LENGTH, dtype=float).tolist()
    parts = {"a_run1": values[:gap_at], "a_run2": values[gap_at:]}
    outcome = exported(content, "edf", "kubios", batch=2 * CHUNK)
    assert _kubios(outcome) == {f"{name}.txt": told for name, told in parts.items()}
    # A record may be filled up behind the last sample.
    written = {name: told[: len(parts[Path(name).stem])] for name, told in _edf(outcome).items()}
    assert written == {f"{name}.bdf": told for name, told in parts.items()}


def test_the_samples_of_two_streams_of_one_name_stay_apart(exported: Exporting) -> None:
    content = made.xdf(
        _with_runs(1, "ECG", _stamps(20), 0),
        _with_runs(2, "ECG", _stamps(), 1000),
        _with_runs(3, "ecg_RUN1", _stamps(), 2000),
        _with_runs(4, "ECG_2", _stamps(30), 3000),
    )
    values = np.arange(RUN_LENGTH, dtype=float)
    expected = {
        "ECG_run1": values[:20],
        "ECG_run2": values[20:],
        "ECG_2": values + 1000,
        "ecg_RUN1_2": values + 2000,
        "ECG_2_2_run1": values[:30] + 3000,
        "ECG_2_2_run2": values[30:] + 3000,
    }
    outcome = exported(content, "edf", "kubios")
    assert _kubios(outcome) == {f"{name}.txt": told.tolist() for name, told in expected.items()}
    assert {Path(each).stem for each in _edf(outcome)} == expected.keys()


@pytest.mark.parametrize("name", ["edf", "kubios"])
def test_why_nothing_was_written_is_said(
    name: str, exported: Exporting, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs, "MOST_RUNS", 1)
    stamps = _stamps(20)
    stamps[40:] += GAP_S
    with pytest.raises(RecordingError) as caught:
        exported(made.xdf(_with_runs(1, "a", stamps, 0)), name)
    assert caught.value.reason is RecordingReason.EMPTY
    assert str(caught.value).endswith(
        "; a: left out, because it has more than 1 gaps; with even times, a gap does not end a file"
    )


def test_samples_lost_one_by_one_are_told_and_with_even_times_stay_in_one_file(
    exported: Exporting, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of exact stamps; also where a line through all of them would show none of it."""
    monkeypatch.setattr(runs, "MOST_RUNS", 15)
    is_kept = np.ones(2600, bool)
    is_kept[100:2500:120] = False
    values = np.arange(2600.0)[is_kept]
    stamps = (BEGIN_S + np.arange(2600) / RATE)[is_kept]
    content = made.xdf(
        made.stream_header(1, "strap", kind="ECG", rate=RATE),
        made.samples(1, "float32", values[:, np.newaxis].tolist(), stamps.tolist()),
        made.footer(1, len(stamps)),
    )
    (measured,) = check(content).streams
    assert (measured.figures.gaps.count, measured.figures.gaps.lost) == (20, 20)
    with pytest.raises(RecordingError, match="more than 15 gaps; with even times"):
        exported(content, "edf", "kubios")
    outcome = exported(content, "edf", "kubios", times=Times.EVEN)
    assert outcome.is_whole
    (text,) = (each.path for each in outcome.written if each.format == "kubios")
    told = np.loadtxt(text / "strap.txt")
    assert told[is_kept].tolist() == values.tolist()
    assert np.isnan(told[~is_kept]).all()
    (edf,) = (each.path for each in outcome.written if each.format == "edf")
    read = read_bdf(edf / "strap.bdf")
    assert sum(each.text == runs.BAD_GAP for each in read.annotations) == 20
    assert len(read.signals[0].data) >= 2600


def test_a_stream_that_is_left_out_makes_it_not_whole(
    exported: Exporting, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs, "MOST_RUNS", 1)
    stamps = _stamps(20)
    stamps[40:] += GAP_S
    content = made.xdf(_with_runs(1, "a", stamps, 0), _with_runs(2, "b", _stamps(), 0))
    outcome = exported(content, "edf")
    assert not outcome.is_whole
    assert _edf(outcome).keys() == {"b.bdf"}


BURST, BURSTS, LOST_BURST = 73, 60, 40


def _in_bursts(*, is_lost: bool) -> bytes:
    """What a sender stamps when a packet comes; one of them may have been lost."""
    measured = BEGIN_S + np.arange(BURST * BURSTS) / REAL_HZ
    stamps = np.repeat(measured[BURST - 1 :: BURST], BURST)
    if is_lost:
        stamps = np.delete(stamps, slice(LOST_BURST * BURST, (LOST_BURST + 1) * BURST))
    values = np.arange(len(stamps), dtype=np.float32)[:, np.newaxis]
    return made.xdf(
        made.stream_header(1, "strap", kind="ECG", rate=130.0),
        made.samples(1, "float32", values.tolist(), stamps.tolist()),
    )


def test_what_is_stamped_in_bursts_is_one_run_at_its_real_rate(exported: Exporting) -> None:
    outcome = exported(_in_bursts(is_lost=False), "edf", "kubios", "bids")
    values = np.arange(BURST * BURSTS, dtype=float).tolist()
    assert _kubios(outcome) == {"strap.txt": values}
    (told,) = (note for each in outcome.written for note in each.notes if "tell Kubios" in note)
    assert "129.8 Hz" in told
    (edf,) = (each.path for each in outcome.written if each.format == "edf")
    (signal,) = read_bdf(edf / "strap.bdf").signals
    assert signal.sampling_frequency == pytest.approx(REAL_HZ, rel=1e-3)
    (bids,) = (each.path for each in outcome.written if each.format == "bids")
    (sidecar,) = bids.rglob("*_physio.json")
    content = json.loads(sidecar.read_text())
    assert content["SamplingFrequency"] == pytest.approx(REAL_HZ, rel=1e-3)
    assert content["Gaps"] == 0


def test_a_burst_that_was_lost_ends_a_run(exported: Exporting) -> None:
    outcome = exported(_in_bursts(is_lost=True), "edf", "kubios")
    assert {name: len(told) for name, told in _kubios(outcome).items()} == {
        "strap_run1.txt": LOST_BURST * BURST,
        "strap_run2.txt": (BURSTS - LOST_BURST - 1) * BURST,
    }


@pytest.mark.parametrize(
    ("lost", "text"),
    [([1], "1 gap, about 1 sample missing"), ([2, 3], "2 gaps, about 5 samples missing")],
)
def test_gaps_are_told_with_all_that_is_missing(lost: list[int], text: str) -> None:
    assert runs.gap_text(lost) == text
