"""BDF files, read by edfio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from hypothesis import given
from hypothesis import strategies as st
from typer import Typer
from typer.testing import CliRunner

from biosensor_common.errors import GatewayError
from biosensor_gateway.cli import xdf
from biosensor_gateway.cli.features import features
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.edf.bdf import (
    Annotation,
    annotation_records,
    channel,
    layout,
)
from biosensor_gateway.recording.export.exporter import FORMATS, Clock, Times
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from tests.page.test_whose import Page
from tests.recording_export import odd_shapes
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S, ecg_values, study
from tests.xdf import xdf_file as made
from tests.xdf.checking import check


def _regular(values: np.ndarray, rate: float, stamps: np.ndarray) -> bytes:
    header = made.stream_header(1, "a", channels=values.shape[1], rate=rate)
    chunks = [
        made.samples(1, "float32", values[at : at + 40].tolist(), list(stamps[at : at + 40]))
        for at in range(0, len(values), 40)
    ]
    return made.xdf(header, *chunks)


def test_each_run_is_a_file(exported: Exporting) -> None:
    (written,) = exported(study(), "edf", clock=Clock.WALL).written
    files = [written.path / f"P1-polar_h10-U1-ecg_run{n}.bdf" for n in (1, 2)]
    opened = [read_bdf(each) for each in files]
    for part, made_of in zip(opened, np.split(ecg_values(2600)[:, 0], 2), strict=True):
        (signal,) = part.signals
        assert (signal.label, signal.physical_dimension) == ("ECG", "uV")
        assert signal.sampling_frequency == 130
        step = (signal.physical_max - signal.physical_min) / 2**24
        np.testing.assert_allclose(signal.data, made_of, rtol=0, atol=step)
    assert opened[0].patient.code == "P1"
    begun = opened[0].startdatetime
    assert (begun.isoformat(), opened[0].starttime.microsecond) == (
        "2026-09-21T14:13:20.250000",
        250000,
    )
    # As the reader says it: since the begin.
    told = [(round(each.onset, 3), each.text) for each in opened[0].annotations]
    assert told == [(0.0, f"LSL time {BEGIN_S:.6f} s"), (3.0, "go")]
    assert any("2 files" in each for each in written.notes)


def test_values_that_are_none_are_annotated(exported: Exporting) -> None:
    values = np.ones((100, 2), np.float32)
    values[30:50, 1] = np.nan
    (written,) = exported(_regular(values, 10.0, BEGIN_S + np.arange(100) / 10), "edf").written
    opened = read_bdf(written.path / "a.bdf")
    (hole,) = [each for each in opened.annotations if each.text.startswith("no value")]
    assert (round(hole.onset, 6), round(hole.duration or 0, 6)) == (3.0, 2.0)
    assert hole.text == "no value: 2"
    assert opened.signals[1].data[30:50].tolist() == [opened.signals[1].physical_min] * 20


@pytest.mark.parametrize("rate", [125 / 7, 129.6, 0.25, 1000 / 3, 4.0])
def test_a_rate_need_not_be_whole(rate: float, exported: Exporting) -> None:
    count = max(50, round(rate * 20))
    values = np.arange(count, dtype=np.float32)[:, np.newaxis]
    stamps = BEGIN_S + np.arange(count) / rate
    (written,) = exported(_regular(values, rate, stamps), "edf").written
    (signal,) = read_bdf(written.path / "a.bdf").signals
    assert signal.sampling_frequency == pytest.approx(rate, rel=1e-6)
    np.testing.assert_allclose(signal.data[:count], values[:, 0], atol=count / 2**23)


def test_a_rate_that_is_not_the_nominal_one_is_measured(exported: Exporting) -> None:
    stamps = BEGIN_S + np.arange(2000) / 99.0
    values = np.zeros((2000, 1), np.float32)
    (written,) = exported(_regular(values, 100.0, stamps), "edf").written
    opened = read_bdf(written.path / "a.bdf")
    assert opened.signals[0].sampling_frequency == pytest.approx(99.0, rel=1e-6)
    assert opened.annotations[-1].text.startswith("end of data")
    assert opened.annotations[-1].onset == pytest.approx(2000 / 99.0, abs=1e-5)


@pytest.mark.parametrize("value", [1e30, 3e38])
def test_a_range_beyond_the_header_leaves_a_channel_out(value: float, exported: Exporting) -> None:
    values = np.tile(np.array([[value, 2.0]], np.float32), (20, 1))
    (written,) = exported(_regular(values, 10.0, BEGIN_S + np.arange(20) / 10), "edf").written
    assert [each.label for each in read_bdf(written.path / "a.bdf").signals] == ["2"]
    assert any("without 1" in each for each in written.notes)


def test_values_near_the_largest_are_out_of_range() -> None:
    assert channel(0, "a", "V", -1e308, 1e308) is None


@given(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9))
def test_ranges_hold_what_is_in_them(one: float, other: float) -> None:
    least, greatest = sorted((one, other))
    found = channel(0, "a", "mV", least, greatest)
    if found is None:
        assert max(abs(least), abs(greatest)) > 9e6
        return
    assert found.least <= least <= greatest <= found.greatest
    assert found.least < found.greatest


@given(st.integers(1, 10**7), st.floats(0.01, 5000))
def test_records_hold_all_samples_at_their_rate(count: int, rate: float) -> None:
    found = layout(count, rate)
    assert (found.records - 1) * found.samples < count <= found.records * found.samples
    assert found.rate_hz == pytest.approx(rate, rel=1e-5)
    assert len(f"{found.record_s}") <= 9


@given(st.lists(st.tuples(st.floats(0, 30), st.text(max_size=300)), max_size=60))
def test_every_annotation_finds_a_place(told: list[tuple[float, str]]) -> None:
    given_ = sorted(Annotation(at, 0.0, text) for at, text in told)
    placed, room = annotation_records(given_, 20, 1.0, 0.5)
    assert len(placed) == 20
    assert max(map(len, placed)) <= room
    assert room % 3 == 0
    assert sum(each.count(b"\x14\x00") for each in placed) == 20 + len(given_)


def test_many_chunks_of_any_size_are_one_file(exported: Exporting, tmp_path: Path) -> None:
    values = ecg_values(1001)
    (written,) = exported(_regular(values, 16.0, BEGIN_S + np.arange(1001) / 16), "edf").written
    (signal,) = read_bdf(written.path / "a.bdf").signals
    assert len(signal.data) == 1008
    np.testing.assert_allclose(signal.data[:1001], values[:, 0], atol=1e-3)
    assert set(signal.data[1001:].tolist()) == {signal.data[1000]}


def test_no_measured_value_is_what_stands_in_a_gap(exported: Exporting) -> None:
    values: list[list[float]] = [
        [-3.0 + each % 7, 1e6 + 1e-3 * (each % 3), 5.0] for each in range(1000)
    ]
    values[500] = [np.nan] * 3
    stamps = [BEGIN_S + each / 100 + 4.0 * (each > 700) for each in range(1000)]
    content = made.xdf(
        made.stream_header(1, "a", channels=3, rate=100.0, fmt="double64"),
        made.samples(1, "double64", values, stamps),
    )
    (written,) = exported(content, "edf", times=Times.EVEN).written
    (path,) = written.path.glob("*.bdf")
    file = read_bdf(path)
    gap = slice(701, 1101)
    for place, signal in enumerate(file.signals):
        data = signal.data[: 1000 + 400]
        is_none = np.zeros(len(data), bool)
        is_none[500] = is_none[gap] = True
        assert (data[is_none] == signal.physical_min).all()
        assert data[~is_none].min() > signal.physical_min
        assert data[0] == pytest.approx(
            values[0][place], abs=(signal.physical_max - signal.physical_min) / 2**23
        )


@pytest.mark.parametrize(
    ("is_even", "options", "said"),
    [
        (True, [], "treated as 10 Hz, the rate of a line through its timestamps"),
        (True, ["--rate", "b=5"], "--rate b: no stream without a rate"),
        (False, ["--rate", "8"], "treated as about 8 Hz, as --rate says"),
        (False, ["--rate", "b=5", "--rate", "a=8"], "treated as about 8 Hz, as --rate says"),
    ],
)
def test_the_command_takes_the_rate_of_a_stream_whose_header_names_none(
    tmp_path: Path, is_even: bool, options: list[str], said: str
) -> None:
    path = tmp_path / "study.xdf"
    steps = [0.1] * 400 if is_even else np.random.default_rng(3).exponential(0.1, 400)
    stamps = (BEGIN_S + np.cumsum(steps)).tolist()
    rows = [[float(each % 50)] for each in range(400)]
    header = made.stream_header(1, "a", kind="Respiration", channels=1, rate=0.0)
    path.write_bytes(made.xdf(header, made.samples(1, "float32", rows, stamps)))
    command = ["export", str(path), "--to", "edf"]
    if not is_even:
        refused = CliRunner().invoke(xdf.app, command)
        assert isinstance(refused.exception, RecordingError)
        assert "--rate HZ" in str(refused.exception)
    outcome = CliRunner().invoke(xdf.app, [*command, *options])
    assert outcome.exit_code == 0, outcome.output
    assert said in outcome.output
    # The rate asked for makes it a signal; its stamps say how fast it is.
    (signal,) = read_bdf(next((tmp_path / "study_edf").glob("*.bdf"))).signals
    assert signal.sampling_frequency == pytest.approx(10, rel=0.15)


# Whatever a file holds, each command says in a sentence what it does, and what is left out.

FILES = odd_shapes.files()
# What nobody may take for a good recording.
WRONG = {
    "stamps that decrease": "wrong-clock",
    "stamps in any order": "wrong-clock",
    "stamps that are all equal": "wrong-clock",
    "stamps that are no number": "bad-stamps",
    "no stamp that is a number": "bad-stamps",
    "a rate of gigahertz": "rate",
    "two streams of one uid": "duplicate-source-id",
}


def _command() -> Typer:
    command = Typer(pretty_exceptions_enable=False)
    command.add_typer(xdf.app, name="xdf")
    command.command("features")(features)
    return command


@pytest.mark.parametrize("shape", FILES)
def test_no_command_fails_without_a_sentence(shape: str, tmp_path: Path) -> None:
    name, data = FILES[shape]
    path = tmp_path / name
    path.write_bytes(data)
    commands = [
        ["xdf", "check", str(path)],
        ["xdf", "check", str(path), "--json"],
        ["xdf", "salvage", str(path), "--output", str(tmp_path / "salvaged.xdf")],
        ["features", str(path), "--output", str(tmp_path / "features.csv")],
    ]
    command, runner = _command(), CliRunner()
    for each in commands:
        result = runner.invoke(command, each)
        assert result.exit_code in (0, 1), (each, result.output)
        is_expected = isinstance(result.exception, SystemExit | GatewayError | None)
        assert is_expected, (each, result.exception)
        assert result.output.strip() or result.exception, each
    (tmp_path / "state").mkdir()
    code, told = Page(tmp_path / "state", "").ask("POST", "recordings/check", {"path": str(path)})
    assert code < 500, told


@pytest.mark.parametrize("times", Times)
@pytest.mark.parametrize("shape", FILES)
def test_every_format_takes_what_it_can(shape: str, times: Times, tmp_path: Path) -> None:
    name, data = FILES[shape]
    path = tmp_path / name
    path.write_bytes(data)
    for format_ in FORMATS:
        place = tmp_path / format_
        place.mkdir()
        task = Task([format_], Selection(), output=place, times=times, is_wide=True)
        try:
            outcome = export(path, task, lambda _name, _s: lambda _done: None)
        except RecordingError as error:
            assert str(error).strip()
            assert not list(place.iterdir())
            continue
        (written,) = outcome.written
        assert written.path.exists()
        readmes = [each for each in place.rglob("*README*") if each.is_file()]
        assert readmes, f"{format_} says nowhere what is what"
        if "no number" in shape or "no stamp that" in shape:
            assert not outcome.is_whole


@pytest.mark.parametrize("shape", WRONG)
def test_what_tells_no_time_is_an_error(shape: str) -> None:
    report = check(odd_shapes.content(shape))
    assert not report.is_good
    assert WRONG[shape] in {each.code for each in report.findings if each.level is Level.ERROR}
    assert as_text(report)
    assert as_json(report)


def test_stamps_in_no_order_are_one_run(exported: Exporting) -> None:
    outcome = exported(odd_shapes.content("stamps in any order"), "edf", "kubios")
    edf, kubios = (each.path for each in outcome.written)
    assert len(list(edf.glob("*.bdf"))) == 1
    assert len(list(kubios.glob("ecg*.txt"))) == 1
    assert any("no order" in note for note in outcome.clock_notes)


def test_a_rate_that_nothing_keeps_to_makes_no_endless_table(exported: Exporting) -> None:
    (written,) = exported(odd_shapes.content("a rate of gigahertz"), "bids").written
    assert written.size < 1_000_000
