"""A run that does not come about says why in the log file: its window may be gone."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from biosensor_common.errors import ConfigReason
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.system.logs import LOG_FILE_NAME

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]

_BREAK = """
from biosensor_gateway.cli import agent_process
def broken(*arguments):
    raise RuntimeError("a mistake in the agent")
agent_process.Agent = broken
"""


def logged(folder: Path) -> dict[str, Any]:
    (line,) = (folder / LOG_FILE_NAME).read_text(encoding="utf-8").splitlines()
    return json.loads(line)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, ConfigReason.NOT_FOUND),
        ("[lsl]\nsesion_id = 1\n", ConfigReason.UNKNOWN_KEY),
        ("[lsl", ConfigReason.MALFORMED),
    ],
)
def test_wrong_settings_are_in_the_file_as_on_the_console(
    run: Run, settings: Path, state: Path, text: str | None, reason: ConfigReason
) -> None:
    if text is not None:
        settings.parent.mkdir()
        settings.write_text(text)
    outcome = run("run")
    assert outcome.code == 2
    entry = logged(state)
    assert (entry["level"], entry["reason"]) == ("error", reason.value)
    assert str(settings) in entry["event"]
    assert outcome.err == f"biosensor-gateway: {entry['event']}\n"


@pytest.mark.nightly
def test_the_file_of_another_agent_is_left_alone(run: Run, state: Path) -> None:
    with single_instance(state):
        assert run("run", "--simulate", "zephyr").code == 2
        assert not (state / LOG_FILE_NAME).exists()


def test_old_files_are_not_rotated_away(run: Run, state: Path) -> None:
    state.mkdir()
    full = state / LOG_FILE_NAME
    # The settings, which cannot be read, may allow more than a file has by default.
    with full.open("xb") as file:
        file.truncate(20_000_000)
    assert run("run").code == 2
    assert [each.name for each in state.iterdir() if each.name.startswith(full.name)] == [full.name]


@pytest.mark.nightly
def test_a_mistake_of_ours_is_there_with_its_traceback(
    cli_process: StartCli, tmp_path: Path
) -> None:
    arguments = ("run", "--simulate", "zephyr")
    with cli_process(tmp_path, *arguments, before=_BREAK) as process:
        assert process.wait(120.0) == 1
    entry = logged(tmp_path)
    assert entry["event"] == "the agent failed"
    assert entry["exception"].endswith("RuntimeError: a mistake in the agent")
    assert "RuntimeError: a mistake in the agent" in (tmp_path / "stderr.txt").read_text()


def test_a_folder_that_cannot_be_written_changes_nothing(
    run: Run, settings: Path, state: Path
) -> None:
    state.touch()
    outcome = run("run")
    assert outcome.code == 2
    assert outcome.err.startswith("biosensor-gateway: there is no settings file")
    assert outcome.err.count("\n") == 1
