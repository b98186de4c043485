"""Times as recorded, which is the default, and even ones; what becomes of gaps with each."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from numpy.typing import NDArray

from biosensor_gateway.recording.export.exporter import Times
from biosensor_gateway.recording.export.outcome import Outcome, Written
from tests.recording_export.bids_shapes import EEG_VALUES, eeg
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S, ecg_values, study
from tests.xdf import xdf_file as made

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
    (note,) = (each for each in written.notes if "even times" in each)
    # A packet is half of its length before or behind the line.
    assert float(note.split("at most ")[1].split(" ms")[0]) == pytest.approx(
        36 / REAL_HZ * 1e3, rel=0.1
    )


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
    assert any("1 stamp is far away" in note for note in written.notes)


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
