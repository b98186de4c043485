"""A rate that changes in the middle is told once, and each part is exported at its own rate."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf

from biosensor_gateway.features.offline import compute
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.exporter import Times
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.xdf.findings import Level
from tests.features import signals
from tests.xdf import test_pace as stamped
from tests.xdf import xdf_file as made
from tests.xdf.checking import check

Array = stamped.Array
RATE = 130.0


def _at_rates(*parts: tuple[float, float]) -> Array:
    """Stamps of parts of a rate in Hz and a length in s."""
    steps = [np.full(round(rate * length_s), 1 / rate) for rate, length_s in parts]
    return 1000.0 + np.cumsum(np.concatenate(steps))


def _in_bursts(stamps: Array, burst: int = 13) -> Array:
    last = np.minimum(np.arange(len(stamps)) // burst * burst + burst, len(stamps)) - 1
    return stamps[last]


def _delayed(stamps: Array) -> Array:
    return stamps + np.random.default_rng(1).exponential(0.01, len(stamps))


def _with_holes(stamps: Array) -> Array:
    return np.delete(stamps, [*range(500, 560), *range(6000, 6040)])


def _recording(
    stamps: Array, rate: float = RATE, chunk: int = 65, values: Array | None = None
) -> bytes:
    signal = np.sin(stamps * 7) if values is None else values
    rows, times = signal.astype(np.float32)[:, np.newaxis].tolist(), stamps.tolist()
    parts = [
        made.samples(1, "float32", rows[at : at + chunk], times[at : at + chunk])
        for at in range(0, len(times), chunk)
    ]
    header = made.stream_header(1, "ecg", kind="ECG", rate=rate, source_id="id1")
    return made.xdf(header, *parts, made.footer(1, len(times)))


HALVED, DOUBLED = [(RATE, 40.0), (RATE / 2, 40.0)], [(RATE, 40.0), (2 * RATE, 40.0)]
AND_BACK = [(RATE, 30.0), (RATE / 2, 40.0), (RATE, 30.0)]
CASES = {
    "halved": (_at_rates(*HALVED), HALVED),
    "doubled": (_at_rates(*DOUBLED), DOUBLED),
    "and back": (_at_rates(*AND_BACK), AND_BACK),
    "a tenth less": (_at_rates((250.0, 40.0), (225.0, 40.0)), [(250.0, 40.0), (225.0, 40.0)]),
    "halved, in bursts": (_in_bursts(_at_rates(*HALVED)), HALVED),
    "doubled, in bursts": (_in_bursts(_at_rates(*DOUBLED)), DOUBLED),
    "halved, delayed": (_delayed(_at_rates(*HALVED)), HALVED),
    "halved, with gaps": (_with_holes(_at_rates(*HALVED)), HALVED),
    "halved behind a gap": (
        np.concatenate([_at_rates(*HALVED)[:5200], _at_rates(*HALVED)[5200:] + 7.0]),
        HALVED,
    ),
    "halved, a short one in bursts": (
        _in_bursts(_at_rates((RATE, 10.0), (RATE / 2, 10.0))),
        [(RATE, 10.0), (RATE / 2, 10.0)],
    ),
    "another at first": (_at_rates((RATE / 2, 20.0), (RATE, 60.0)), [(65.0, 20.0), (RATE, 60.0)]),
}


@pytest.mark.parametrize("case", CASES)
def test_check_tells_each_change_once(case: str) -> None:
    stamps, parts = CASES[case]
    report = check(_recording(stamps, rate=parts[0][0]))
    told = [each for each in report.findings if each.code == "rate-change"]
    assert [each.level for each in told] == [Level.ERROR] * (len(parts) - 1)
    (stream,) = report.streams
    changes = stream.figures.rate_changes
    rates = [changes[0].before_hz, *(each.after_hz for each in changes)]
    exact = 0.03 if case == "halved, a short one in bursts" else 0.01
    assert rates == pytest.approx([rate for rate, _ in parts], rel=exact)
    # As exactly as bursts and delays allow.
    ends = 1000.0 + np.cumsum([length for _, length in parts])[:-1]
    is_behind_gap = case == "halved behind a gap"
    expected = (ends + 7.0 * is_behind_gap).tolist()
    assert [each.stamp_s for each in changes] == pytest.approx(expected, abs=0.25)
    assert stream.figures.gaps.count == (2 if case == "halved, with gaps" else is_behind_gap)
    if is_behind_gap:
        assert stream.figures.gaps.lost == pytest.approx(7 * RATE / 2, abs=2)
    assert "rate" not in {each.code for each in report.findings}


@pytest.mark.parametrize("name", [*stamped.HARMLESS, *stamped.LOSSES])
def test_what_is_late_or_lost_is_no_change(name: str) -> None:
    if name in stamped.HARMLESS:
        stamps = stamped.HARMLESS[name]
    else:
        stamps = stamped.without(*stamped.LOSSES[name])
    (stream,) = check(_recording(stamps)).streams
    assert stream.figures.rate_changes == ()


@pytest.mark.parametrize("lost", ["a third", "half", "each second packet"])
def test_samples_that_are_missing_here_and_there_are_no_change(lost: str) -> None:
    stamps = _at_rates((RATE, 80.0))
    drawn = np.random.default_rng(1).random(len(stamps))
    packets = np.arange(len(stamps)) // 100 % 2 == 0
    is_here = {"a third": drawn > 1 / 3, "half": drawn > 0.5, "each second packet": packets}[lost]
    is_here[: len(stamps) // 2] = True
    (stream,) = check(_recording(stamps[is_here])).streams
    assert stream.figures.rate_changes == ()
    assert stream.figures.gaps.count > 20


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("times", Times)
@pytest.mark.parametrize("chunk", [65, 20_000])
def test_each_part_is_exported_at_its_rate(
    case: str, times: Times, chunk: int, tmp_path: Path
) -> None:
    stamps, parts = CASES[case]
    path = tmp_path / "rec.xdf"
    path.write_bytes(_recording(stamps, rate=parts[0][0], chunk=chunk))
    task = Task(["csv", "edf", "kubios", "bids"], Selection(), times=times, is_wide=True)
    outcome = export(path, task, lambda _name, _s: lambda _done: None)
    written = {each.format: each for each in outcome.written}
    for each in written.values():
        assert any("its rate changes: " in note for note in each.notes), each.format
    rates = [rate for rate, _ in parts]
    files = sorted(written["edf"].path.glob("*.bdf"))
    if case != "halved, with gaps":
        assert [each.name for each in files] == [
            f"ecg{number}.bdf" for number in ("", "_2", "_3")[: len(parts)]
        ]
        found = [read_bdf(each).signals[0].sampling_frequency for each in files]
        assert found == pytest.approx(rates, rel=0.01)
    texts = sorted(written["kubios"].path.glob("*.txt"))
    texts = [each for each in texts if each.name != "README.txt"]
    assert sum(len(each.read_text().split()) for each in texts) >= len(stamps)
    sidecars = [json.loads(each.read_text()) for each in written["bids"].path.rglob("*physio.json")]
    told = sorted((each["SamplingFrequency"], each["Samples"]) for each in sidecars)
    assert [rate for rate, _ in told] == pytest.approx(sorted(rates), rel=0.01)
    assert sum(count for _, count in told) == len(stamps)
    tables = list(written["csv"].path.glob("ecg*.csv"))
    assert sum(len(each.read_text().splitlines()) - 1 for each in tables) == len(stamps)


@pytest.mark.parametrize("case", ["halved", "doubled", "and back", "halved, in bursts"])
def test_features_find_the_beats_of_each_part(case: str, tmp_path: Path) -> None:
    stamps, parts = CASES[case]
    fine, beats = signals.ecg(1000.0, 100.0)
    # Bursts are stamped late, but measured evenly.
    measured = _at_rates(*parts) - 1000.0
    content = _recording(stamps, values=np.interp(measured, np.arange(len(fine)) / 1000.0, fine))
    path, table = tmp_path / "rec.xdf", tmp_path / "features.csv"
    path.write_bytes(content)
    computed = compute(path, table)
    assert any("its rate changes: " in each for each in computed.remarks)
    with table.open() as file:
        rows = [row for row in csv.DictReader(file) if row["stream"].endswith("hr_live")]
    found = np.unique([float(row["time_s"]) for row in rows]) - 1000.0
    beats = beats[beats < measured[-1]]
    # Each part begins anew, and needs a few beats for that.
    assert len(found) >= len(beats) - 6 * len(parts)
    nearest = np.abs(found[:, np.newaxis] - beats).min(axis=1)
    assert nearest.max() < (0.25 if "bursts" in case else 0.05)


# Smaller changes of the rate make no parts, but are told by what they cost.


@pytest.mark.parametrize("percent", [0.3, 0.5, 1.0, -0.5, -1.0])
@pytest.mark.parametrize("how", ["exact", "in bursts", "delayed"])
def test_a_line_that_is_far_from_the_stamps_is_told(percent: float, how: str) -> None:
    report = check(_recording(_changed(percent, how)))
    (found,) = (each for each in report.findings if each.code in {"bent", "rate-change"})
    assert found.level is Level.WARNING
    (stream,) = report.streams
    assert stream.figures.gaps.count == 0
    if found.code == "bent":
        assert stream.figures.bend is not None
        # No line is nearer than half of how far one through either half is from the other end.
        assert stream.figures.bend.away_s > 0.9 * abs(percent) / 100 * 200 / 4


@pytest.mark.parametrize("percent", [1.5, 2.0, 3.0, 4.0, -1.5, -2.0, -3.0, -4.0])
@pytest.mark.parametrize("how", ["exact", "in bursts", "delayed"])
def test_a_small_change_makes_two_parts_and_no_loss(percent: float, how: str) -> None:
    report = check(_recording(_changed(percent, how)))
    (found,) = (each for each in report.findings if each.code == "rate-change")
    assert found.level is Level.WARNING
    (stream,) = report.streams
    (change,) = stream.figures.rate_changes
    rates = [change.before_hz, change.after_hz]
    assert rates == pytest.approx([RATE, RATE * (1 + percent / 100)], rel=0.003)
    assert change.stamp_s == pytest.approx(1200.0, abs=4.0)
    assert stream.figures.gaps.count == 0
    assert stream.figures.bend is None or stream.figures.bend.away_s < 0.1


@pytest.mark.parametrize("share", [0.02, 0.04])
def test_a_few_exact_stamps_that_are_missing_by_chance_are_no_small_change(share: float) -> None:
    stamps = _at_rates((RATE, 400.0))
    is_here = np.random.default_rng(1).random(len(stamps)) > share
    is_here[: len(stamps) // 2] = True
    (stream,) = check(_recording(stamps[is_here])).streams
    assert stream.figures.rate_changes == ()
    assert stream.figures.gaps.lost == pytest.approx(np.count_nonzero(~is_here), abs=3)


@pytest.mark.parametrize("seconds", [7.0, 30.0, 120.0])
def test_a_rate_that_wanders_all_the_time_makes_no_parts(seconds: float) -> None:
    """As of a game or a camera."""
    rates = 60.0 * (1 + 0.02 * np.sin(2 * np.pi * np.arange(0, 600, 1 / 60) / seconds))
    (stream,) = check(_recording(1000.0 + np.cumsum(1 / rates), rate=60.0)).streams
    assert stream.figures.rate_changes == ()


def _changed(percent: float, how: str) -> Array:
    stamps = _at_rates((RATE, 200.0), (RATE * (1 + percent / 100), 200.0))
    return {"exact": stamps, "in bursts": _in_bursts(stamps), "delayed": _delayed(stamps)}[how]


@pytest.mark.parametrize("name", stamped.HARMLESS)
def test_what_is_only_late_is_not_bent(name: str) -> None:
    report = check(_recording(stamped.HARMLESS[name]))
    assert "bent" not in {each.code for each in report.findings}


@pytest.mark.parametrize("case", ["a recording of a day", "a clock that is 200 ppm off"])
def test_a_clock_that_is_off_all_the_time_is_not_bent(case: str) -> None:
    length_s, rate = (86_400.0, 10.0) if case == "a recording of a day" else (600.0, 130.026)
    stamps = _delayed(1000.0 + np.arange(round(length_s * rate)) / rate)
    report = check(_recording(stamps, rate=round(rate), chunk=1000))
    assert "bent" not in {each.code for each in report.findings}


def test_a_line_in_another_format_is_as_far_away_as_check_says(tmp_path: Path) -> None:
    stamps = _at_rates((RATE, 200.0), (RATE * 1.01, 200.0))
    path = tmp_path / "rec.xdf"
    path.write_bytes(_recording(stamps))
    outcome = export(path, Task(["edf"], Selection()), lambda _name, _s: lambda _done: None)
    (told,) = (each for each in outcome.written[0].notes if "from the recorded ones" in each)
    bend = check(path.read_bytes()).streams[0].figures.bend
    assert bend is not None
    assert f"at most {bend.away_s * 1e3:.0f}" in told.replace(".", " ")
