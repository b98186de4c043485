"""Whatever a file holds, each command says in a sentence what it does, and what is left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer import Typer
from typer.testing import CliRunner

from biosensor_common.errors import GatewayError
from biosensor_gateway.cli import xdf
from biosensor_gateway.cli.features import features
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export.exporter import Times
from biosensor_gateway.recording.export.exporting import Task, export
from biosensor_gateway.recording.export.formats import FORMATS
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from tests.page.test_whose import Page
from tests.recording_export import odd_shapes
from tests.recording_export.conftest import Exporting
from tests.xdf.checking import check

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
        task = Task([format_], Wish(), output=place, times=times, is_wide=True)
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
