"""Logging: two outputs, one line each, no secrets, and why a run did not come about."""

from __future__ import annotations

import gc
import json
import logging
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import structlog
from _pytest.capture import CaptureResult

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import LOG_FILE_NAME, configure_logs, flush_logs
from tests.rigs.gateway import cli_process
from tests.rigs.kept_logging import kept_logging

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

# Logging: two outputs, one line each, no secrets.

DEADLINE_S = 30.0
LOG = structlog.stdlib.get_logger("biosensor_gateway.test")
LIBRARY = logging.getLogger("some_library.part")


@pytest.fixture(autouse=True)
def restore_logging() -> Iterator[None]:
    with kept_logging():
        yield


def fail_with(text: str) -> None:
    raise RuntimeError(text)


def records(folder: Path) -> list[dict[str, Any]]:
    assert flush_logs(DEADLINE_S)
    lines = (folder / LOG_FILE_NAME).read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def captured(capsys: pytest.CaptureFixture[str]) -> CaptureResult[str]:
    assert flush_logs(DEADLINE_S)
    return capsys.readouterr()


@pytest.mark.seam
def test_an_event_arrives_at_both_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configure_logs(LogSettings(), tmp_path)
    LOG.info("device connected", unit="C0FFEE", rate=130.0)
    (record,) = records(tmp_path)
    stamp = datetime.fromisoformat(record.pop("timestamp"))
    assert stamp.utcoffset() == datetime.now(UTC).utcoffset()
    assert record == {
        "event": "device connected",
        "level": "info",
        "logger": "biosensor_gateway.test",
        "unit": "C0FFEE",
        "rate": 130.0,
    }
    console = captured(capsys)
    assert console.out == ""
    assert "device connected" in console.err
    assert "unit='C0FFEE'" in console.err
    assert console.err.count("\n") == 1
    assert "\x1b" not in console.err


def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)


@pytest.mark.parametrize(
    ("variable", "value", "coloured"),
    [("NO_COLOR", "", True), ("NO_COLOR", "1", False), ("TERM", "dumb", False)],
)
def test_a_terminal_gets_colours(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    variable: str,
    value: str,
    coloured: bool,
) -> None:
    at_a_terminal(monkeypatch)
    monkeypatch.setenv(variable, value)
    configure_logs(LogSettings(), None)
    LOG.warning("seen")
    assert ("\x1b[" in captured(capsys).err) is coloured


LOST = {"sensor": "zephyr", "unit": "B1", "data": "ecg", "count": 73, "estimated": True}


@pytest.mark.parametrize(
    ("event", "facts", "line"),
    [
        ("it streams", {}, "  it streams"),
        ("lost", LOST, "  Sensor zephyr B1: lost (data ecg, count 73, estimated)"),
        ("kept awake", {"way": "execution state", "error": None}, "  kept awake"),
        ("tells", {"event_name": "x", "code": 7, "text": "Charge it."}, "  Charge it."),
        ("a command came", {"command": "stop", "for_people": "asked to stop"}, "  asked to stop"),
        ("Sensor zephyr is away", {"sensor": "zephyr", "unit": "B1"}, "  Sensor zephyr is away"),
        (
            "packets",
            {"names": ["a", "b"], "seconds": 0.123456789},
            "  packets (names a b, seconds 0.123457)",
        ),
    ],
)
def test_a_terminal_gets_sentences_with_the_local_time_and_the_file_everything(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    event: str,
    facts: dict[str, Any],
    line: str,
) -> None:
    at_a_terminal(monkeypatch)
    configure_logs(LogSettings(), tmp_path, title=lambda sensor: f"Sensor {sensor}")
    LOG.info(event, **facts)
    (record,) = records(tmp_path)
    kept = {key: value for key, value in facts.items() if key != "for_people"}
    stamp = datetime.fromisoformat(record.pop("timestamp"))
    assert stamp.utcoffset() == datetime.now(UTC).utcoffset()
    assert record == {"event": event, "level": "info", "logger": "biosensor_gateway.test"} | kept
    shown = captured(capsys).err
    assert shown == f"{stamp.astimezone():%H:%M:%S} {line}\n"


def test_on_request_a_terminal_gets_all_facts_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    at_a_terminal(monkeypatch)
    configure_logs(LogSettings(), None, verbose=True)
    LOG.debug("a command came", command="stop", for_people="asked to stop", way="pipe")
    assert "a command came (command='stop', way='pipe')" in captured(capsys).err


def test_a_secret_does_not_reach_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    at_a_terminal(monkeypatch)
    configure_logs(LogSettings(), None)
    LOG.warning("told", text="password='hidden' for visible", token="hidden")
    LOG.warning("told", for_people="token: hidden and visible")
    shown = captured(capsys).err
    assert "hidden" not in shown
    assert shown.count("visible") == 2


def test_a_library_goes_the_same_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs(LogSettings(), tmp_path)
    structlog.contextvars.bind_contextvars(device="strap")
    LIBRARY.warning("scan took %d s", 3)
    (record,) = records(tmp_path)
    assert record["event"] == "scan took 3 s"
    assert (record["level"], record["logger"]) == ("warning", "some_library.part")
    assert record["device"] == "strap"
    assert "scan took 3 s" in captured(capsys).err


@pytest.mark.parametrize(
    ("settings", "verbose", "expected"),
    [
        (LogSettings(level="warning"), False, ["own warning", "library warning"]),
        (
            LogSettings(),
            False,
            ["own info", "library info", "own warning", "library warning"],
        ),
        (
            LogSettings(level="error"),
            True,
            ["own debug", "own info", "library info", "own warning", "library warning"],
        ),
    ],
)
def test_the_level_decides_and_libraries_never_debug(
    tmp_path: Path, settings: LogSettings, verbose: bool, expected: list[str]
) -> None:
    configure_logs(settings, tmp_path, verbose=verbose)
    for level in ("debug", "info", "warning"):
        getattr(LOG, level)(f"own {level}")
        getattr(LIBRARY, level)(f"library {level}")
    assert [record["event"] for record in records(tmp_path)] == expected


def test_secrets_are_masked_in_both_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configure_logs(LogSettings(), tmp_path)
    LOG.warning(
        "login",
        client_id="hidden",
        clientSecret="hidden",
        cortex_token="hidden",
        PASSWORD="hidden",
        reply={"params": [{"token": "hidden", "user": "visible"}]},
    )
    LOG.warning('sent {"clientSecret": "hidden one", "id": 7}')
    LIBRARY.warning("GET /?api_key=%s&user=visible", "hidden")
    LIBRARY.warning("Authorization: Bearer hidden")
    LIBRARY.warning("%r", '{\\"clientId\\": \\"hidden\\", \\"user\\": \\"visible\\"}')
    try:
        fail_with("password='hidden' for visible")
    except RuntimeError:
        LOG.exception("failed")
    console = captured(capsys).err
    content = (tmp_path / LOG_FILE_NAME).read_text(encoding="utf-8")
    for output in (content, console):
        assert "hidden" not in output
        assert output.count("visible") >= 4
        assert "7}" in output


def test_an_exception_is_one_line_on_the_console_and_whole_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configure_logs(LogSettings(), tmp_path)
    for logger in (LOG, LIBRARY):
        try:
            fail_with("broken\nin two")
        except RuntimeError:
            logger.exception("it failed")
    console = captured(capsys).err
    assert console.count("\n") == 2
    assert console.count("RuntimeError: broken\\nin two") == 2
    assert "Traceback" not in console
    for record in records(tmp_path):
        assert record["level"] == "error"
        assert record["exception"].startswith("Traceback")
        assert record["exception"].endswith("RuntimeError: broken\nin two")


def test_a_name_from_outside_cannot_command_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure_logs(LogSettings(), None)
    LOG.info("found", name="strap\x1b[2J")
    LOG.info("found strap\x1b[2J\nerror: faked", name="strap\nerror: faked")
    console = captured(capsys).err
    assert "\x1b" not in console
    assert console.count("\n") == 2
    assert console.count("\\x1b[2J") == 2


@pytest.mark.seam
def test_full_files_are_rotated_and_the_oldest_dropped(tmp_path: Path) -> None:
    configure_logs(LogSettings(max_bytes=10_000, keep_files=2), tmp_path)
    for number in range(400):
        LOG.info("filling", number=number, padding="x" * 100)
    assert records(tmp_path)[-1]["number"] == 399
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [LOG_FILE_NAME, f"{LOG_FILE_NAME}.1", f"{LOG_FILE_NAME}.2"]
    assert all(path.stat().st_size <= 10_000 for path in tmp_path.iterdir())


def test_a_second_call_replaces_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    configure_logs(LogSettings(), first)
    LOG.info("one")
    configure_logs(LogSettings(), second)
    LOG.info("two")
    assert [record["event"] for record in records(first)] == ["one"]
    assert [record["event"] for record in records(second)] == ["two"]
    assert captured(capsys).err.count("two") == 1
    # A file left open would be a ResourceWarning here, which is an error.
    gc.collect()


def test_foreign_handlers_stay(tmp_path: Path) -> None:
    foreign = logging.NullHandler()
    logging.getLogger().addHandler(foreign)
    configure_logs(LogSettings(), tmp_path)
    configure_logs(LogSettings(), None)
    assert foreign in logging.getLogger().handlers


def test_a_folder_that_cannot_be_written_leaves_the_logging_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configure_logs(LogSettings(), None)
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write the log file in") as caught:
        configure_logs(LogSettings(), tmp_path / "file")
    assert caught.value.reason is ConfigReason.UNREADABLE
    LOG.info("still here")
    assert captured(capsys).err.count("still here") == 1


def test_without_a_console_the_file_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", None)
    configure_logs(LogSettings(), tmp_path)
    LOG.info("alone")
    assert records(tmp_path)[0]["event"] == "alone"


# A run that does not come about says why in the log file: its window may be gone.
Run = Callable[..., "Outcome"]
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
def test_a_mistake_of_ours_is_there_with_its_traceback(tmp_path: Path) -> None:
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
