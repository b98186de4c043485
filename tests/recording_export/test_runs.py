"""Runs of a stream do not depend on where its batches begin, and their files never clash."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf

from biosensor_gateway.recording.export import kubios, runs
from biosensor_gateway.recording.export.edf import exporter as edf_exporter
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S
from tests.xdf import xdf_file as made

RATE, COUNT, CHUNK = 100.0, 60, 10
GAP_S = 5.0


def _stream(number: int, name: str, stamps: np.ndarray, first: float, kind: str = "ECG") -> bytes:
    """One whose values are counted from `first`, in chunks."""
    values = (first + np.arange(len(stamps), dtype=np.float32))[:, np.newaxis]
    chunks = [
        made.samples(
            number, "float32", values[at : at + CHUNK].tolist(), list(stamps[at : at + CHUNK])
        )
        for at in range(0, len(values), CHUNK)
    ]
    header = made.stream_header(number, name, kind=kind, rate=RATE, source_id=f"{name}{number}")
    return header + b"".join(chunks)


def _stamps(gap_at: int | None = None, step_s: float = GAP_S) -> np.ndarray:
    stamps = BEGIN_S + np.arange(COUNT) / RATE
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
    content = made.xdf(_stream(1, "a", _stamps(gap_at, step_s), 0))
    values = np.arange(COUNT, dtype=float).tolist()
    parts = {"a_run1": values[:gap_at], "a_run2": values[gap_at:]}
    outcome = exported(content, "edf", "kubios", batch=2 * CHUNK)
    assert _kubios(outcome) == {f"{name}.txt": told for name, told in parts.items()}
    # A record may be filled up behind the last sample.
    written = {name: told[: len(parts[Path(name).stem])] for name, told in _edf(outcome).items()}
    assert written == {f"{name}.bdf": told for name, told in parts.items()}


def test_the_samples_of_two_streams_of_one_name_stay_apart(exported: Exporting) -> None:
    content = made.xdf(
        _stream(1, "ECG", _stamps(20), 0),
        _stream(2, "ECG", _stamps(), 1000),
        _stream(3, "ecg_RUN1", _stamps(), 2000),
        _stream(4, "ECG_2", _stamps(30), 3000),
    )
    values = np.arange(COUNT, dtype=float)
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
    for module in (runs, edf_exporter, kubios):
        monkeypatch.setattr(module, "MOST_RUNS", 1)
    stamps = _stamps(20)
    stamps[40:] += GAP_S
    with pytest.raises(RecordingError) as caught:
        exported(made.xdf(_stream(1, "a", stamps, 0)), name)
    assert caught.value.reason is RecordingReason.EMPTY
    assert str(caught.value).endswith("; a: left out, for it has more than 1 gaps")


def test_a_stream_that_is_left_out_makes_it_not_whole(
    exported: Exporting, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (runs, edf_exporter):
        monkeypatch.setattr(module, "MOST_RUNS", 1)
    stamps = _stamps(20)
    stamps[40:] += GAP_S
    content = made.xdf(_stream(1, "a", stamps, 0), _stream(2, "b", _stamps(), 0))
    outcome = exported(content, "edf")
    assert not outcome.is_whole
    assert _edf(outcome).keys() == {"b.bdf"}


BURST, BURSTS, LOST_BURST = 73, 60, 40
REAL_HZ = 129.8


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
