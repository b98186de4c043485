"""A table for each rate: every sample once, in the row of its time, beside what happened."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from biosensor_gateway.cli import xdf as command
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export import exporting
from biosensor_gateway.recording.export.csv import by_rate
from biosensor_gateway.recording.export.exporting import Task
from biosensor_gateway.recording.export.outcome import Written
from tests.recording_export.bids_shapes import BEGIN_S, numbers, stream, times
from tests.xdf import xdf_file as made

RATE = 100.0


def _export(tmp_path: Path, *streams: bytes, name: str = "csv") -> Written:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(*streams))
    task = Task([name], Wish(), is_wide=True)
    (written,) = exporting.export(path, task, lambda _name, _s: lambda _done: None).written
    return written


def _table(written: Written, name: str = "all_100Hz.csv") -> list[dict[str, str]]:
    with (written.path / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _column(rows: Sequence[dict[str, str]], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])


@pytest.mark.parametrize("block", [7, 64, 4096])
def test_every_sample_stands_once_in_the_row_of_its_time(
    block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(by_rate, "_BLOCK", block)
    first, second = numbers(2000, 2), numbers(1500, 1, seed=1)
    late = times(1500, 99.9, BEGIN_S + 3.004)
    gap = times(2000, RATE)
    gap[800:] += 40.0
    written = _export(
        tmp_path,
        stream(1, "a", first, gap, rate=RATE),
        stream(2, "b", second, late, rate=RATE),
        stream(3, "slow", numbers(50), times(50, 4.0), rate=4.0),
        stream(4, "beats", numbers(9), times(9, 1.0)),
    )
    rows = _table(written)
    since = _column(rows, "seconds")
    assert (np.diff(since) > 0).all()
    for name, values, stamps in (
        ("a.1", first[:, 0], gap),
        ("a.2", first[:, 1], gap),
        ("b.1", second[:, 0], late),
    ):
        found = _column(rows, name)
        has_value = ~np.isnan(values)
        at = np.searchsorted(since, stamps[has_value] - BEGIN_S)
        near = np.where(
            np.abs(since[np.minimum(at, len(since) - 1)] - (stamps[has_value] - BEGIN_S))
            <= np.abs(since[at - 1] - (stamps[has_value] - BEGIN_S)),
            np.minimum(at, len(since) - 1),
            at - 1,
        )
        assert found[near].astype(np.float32).tolist() == values[has_value].tolist()
        assert np.count_nonzero(~np.isnan(found)) == np.count_nonzero(has_value)
    # Where nothing was measured stands no row.
    assert not ((since > 20.0) & (since < 47.9)).any()
    assert (written.path / "all_4Hz.csv").exists()
    (note,) = (each for each in written.notes if each.startswith("all_100Hz.csv"))
    assert 4.0 < float(note.split("at most ")[1].split(" ms")[0]) <= 5.01


def test_a_marker_is_at_the_row_of_its_time_or_the_next_one(tmp_path: Path) -> None:
    stamps = times(400, RATE)
    stamps[200:] += 5.0
    told, moments = [["go"], ["in the gap"], ["after"]], [1.0, 4.0, 20.0]
    written = _export(
        tmp_path,
        stream(1, "a", numbers(400), stamps, rate=RATE),
        stream(2, "m", told, [BEGIN_S + each for each in moments], fmt="string", kind="Markers"),
    )
    rows = {row["marker"]: float(row["seconds"]) for row in _table(written) if row["marker"]}
    assert rows == {"go": pytest.approx(1.0), "in the gap": pytest.approx(7.0)}
    assert any("1 marker" in note and "all_markers.csv" in note for note in written.notes)


def test_a_stream_whose_time_steps_back_is_in_no_wide_table_and_that_is_said(
    tmp_path: Path,
) -> None:
    stamps = times(400, RATE)
    stamps[200:] -= 60.0
    written = _export(
        tmp_path,
        stream(1, "a", numbers(400), times(400, RATE), rate=RATE),
        stream(2, "b", numbers(400), stamps, rate=RATE),
    )
    assert not any(name.startswith("b") for name in _table(written)[0])
    assert not written.is_whole
    assert any(note.startswith("b: in no wide table") for note in written.notes)


def test_a_stream_of_the_name_of_a_table_has_another_file(tmp_path: Path) -> None:
    written = _export(tmp_path, stream(1, "all_100Hz", numbers(10), times(10, RATE), rate=RATE))
    assert {each.name for each in written.path.iterdir()} >= {"all_100Hz.csv", "all_100Hz_2.csv"}


def test_the_command_writes_the_table_that_it_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(stream(1, "a", numbers(200), times(200, RATE), rate=RATE)))
    outcome = CliRunner().invoke(command.app, ["export", str(path), "--to", "csv", "--wide"])
    assert outcome.exit_code == 0, outcome.output
    assert (tmp_path / "study_csv" / "all_100Hz.csv").exists()
