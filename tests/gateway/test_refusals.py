"""Commands that refuse, and those that ask before something goes on without a sensor."""

from __future__ import annotations

import builtins
import errno
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.device_set import Device, DeviceChanges, DeviceSet
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.cli import agent as commands
from biosensor_gateway.cli import app, config, record
from biosensor_gateway.cli.app import EXIT_FAILED, EXIT_USAGE, refusal
from biosensor_gateway.cli.config import edit
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.recorder.request import RecordingRequest, SensorsAwayError
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.places import SETTINGS_VARIABLE, STATE_VARIABLE
from biosensor_gateway.streaming.room import Room

# What the system refuses is one sentence, not a traceback.


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "/home/x/.local/state: "),
        (errno.EROFS, "let BIOSENSOR_GATEWAY_STATE name another folder"),
        (errno.ENOSPC, "/home/x/.local/state: "),
        (errno.EMFILE, "no more files can be opened: this computer lets a program open"),
    ],
)
def test_what_the_system_refuses_is_said_with_what_to_do(
    code: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STATE_VARIABLE, "/home/x/.local/state/gateway")
    assert words in refusal(OSError(code, "refused", "/home/x/.local/state"))


def test_what_should_not_happen_keeps_its_traceback() -> None:
    assert refusal(OSError(errno.EBADF, "bad", "/home/x")) == ""
    # Nothing names what was refused.
    assert refusal(OSError(errno.EACCES, "denied")) == ""


def test_a_command_that_is_refused_a_file_ends_with_the_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "/home/x/settings.toml")

    monkeypatch.setattr(app, "app", lambda: refuse)
    monkeypatch.setenv(SETTINGS_VARIABLE, "/home/x/settings.toml")
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == EXIT_FAILED
    said = capsys.readouterr().err
    assert said.startswith("biosensor-gateway: /home/x/settings.toml: Permission denied; ")
    assert SETTINGS_VARIABLE in said


ON_FILES = [
    "xdf check",
    "xdf salvage",
    "xdf export --to csv",
    "replay",
    "features",
    "bag import",
    "capture replay",
    "withdraw P07",
]


@pytest.mark.parametrize("command", ON_FILES)
@pytest.mark.parametrize("name", ["x" * 300, "a_file/beside"])
def test_a_name_that_cannot_be_a_file_is_one_sentence(
    command: str,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "a_file").touch()
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *command.split(), str(tmp_path / name)])
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code in (EXIT_FAILED, EXIT_USAGE)
    said = capsys.readouterr().err
    assert said.count("biosensor-gateway: ") == 1
    assert name in said


@pytest.mark.seam
@pytest.mark.parametrize("command", ["xdf check", "bag import", "withdraw P07"])
def test_a_folder_that_may_not_be_looked_into_is_one_sentence(command: str, tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir()
    (closed / "inside.xdf").touch()
    closed.chmod(0)
    # Root may look into every folder, unless these two capabilities are taken away.
    as_user = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", "--"]
    program = [sys.executable, "-m", "biosensor_gateway.cli"]
    done = subprocess.run(
        [*as_user, *program, *command.split(), str(closed / "inside.xdf")],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    closed.chmod(0o700)
    assert done.returncode in (EXIT_FAILED, EXIT_USAGE)
    assert "Traceback" not in done.stderr
    assert str(closed) in done.stderr


def test_nobody_runs_with_a_folder_that_may_not_be_looked_into() -> None:
    # Not even root can ask for a name that long.
    assert not is_held(Path("/") / ("x" * 300))


# ``record start`` asks before it begins without a sensor that does not stream.
ORDER = RecordingRequest(Path("/data"))
AWAY = SensorsAwayError(["P03's strap is paused since 14:03"])


def _typed(answers: list[str]) -> Callable[[str], str]:
    def give(_question: str) -> str:
        return answers.pop()

    return give


@pytest.fixture
def answer(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a person at the terminal types, the last first."""
    typed: list[str] = []
    monkeypatch.setattr(record, "can_ask", lambda: True)
    monkeypatch.setattr("builtins.input", _typed(typed))
    return typed


def test_who_answers_yes_records_without_it(
    answer: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    answer.append("2")
    assert record.without_sensors(ORDER, AWAY).without_away
    assert "P03's strap is paused since 14:03." in capsys.readouterr().out


def test_enter_alone_records_nothing(answer: list[str]) -> None:
    answer.append("")
    with pytest.raises(typer.Exit) as ended:
        record.without_sensors(ORDER, AWAY)
    assert ended.value.exit_code == 2


def test_where_nobody_can_answer_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "can_ask", lambda: False)
    with pytest.raises(SensorsAwayError):
        record.without_sensors(ORDER, AWAY)


# ``reload`` asks before a recording loses devices.
NOTHING: dict[str, Any] = {"added": [], "removed": [], "restarted": [], "now": [], "later": [],
                           "pending": False}  # fmt: skip
RENAMED = {**NOTHING, "restarted": ["zephyr/A"]}


class Agent:
    """Answers as an agent does."""

    def __init__(self) -> None:
        self.changes = RENAMED
        self.asked: list[str] = []

    def ask(self, _folder: Path, command: str) -> dict[str, Any]:
        self.asked.append(command)
        return self.changes


@pytest.fixture
def agent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Agent:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    running = Agent()
    monkeypatch.setattr(control, "ask", running.ask)
    return running


@pytest.fixture
def recording(tmp_path: Path) -> Generator[Path]:
    folder = RecorderFolder(tmp_path)
    folder.path.mkdir()
    file = tmp_path / "sub-P01_task-walk.xdf"
    folder.save(SavedRecording(str(file), (), 1.0))
    lock = folder.try_lock()
    assert lock is not None
    yield file
    lock.release()


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Have somebody at a terminal who answers."""

    def answers(text: str) -> None:
        def typed(_question: str) -> str:
            return text

        monkeypatch.setattr(commands, "can_ask", lambda: True)
        monkeypatch.setattr(builtins, "input", typed)

    return answers


def test_without_a_recording_nobody_is_asked(agent: Agent) -> None:
    commands.reload()
    assert agent.asked == ["reload"]


def test_without_a_terminal_it_is_refused_and_the_option_named(
    agent: Agent, recording: Path
) -> None:
    with pytest.raises(ConfigError, match="--while-recording") as caught:
        commands.reload()
    assert caught.value.reason is ConfigReason.IN_USE
    assert str(recording) in str(caught.value)
    assert "zephyr/A" in str(caught.value)
    assert agent.asked == ["reload-preview"]


@pytest.mark.usefixtures("recording")
def test_what_is_confirmed_is_done(agent: Agent) -> None:
    commands.reload(while_recording=True)
    assert agent.asked == ["reload"]


@pytest.mark.usefixtures("recording")
def test_what_costs_no_device_is_done(agent: Agent) -> None:
    agent.changes = {**NOTHING, "now": ["markers"]}
    commands.reload()
    assert agent.asked == ["reload-preview", "reload"]


@pytest.mark.usefixtures("recording")
@pytest.mark.parametrize("typed", ["", "1"])
def test_enter_alone_leaves_the_recording_as_it_is(
    agent: Agent, answers: Callable[[str], None], typed: str
) -> None:
    answers(typed)
    with pytest.raises(typer.Exit) as caught:
        commands.reload()
    assert caught.value.exit_code == 2
    assert agent.asked == ["reload-preview"]


@pytest.mark.usefixtures("recording")
def test_whoever_wants_it_says_so(agent: Agent, answers: Callable[[str], None]) -> None:
    answers("2")
    commands.reload()
    assert agent.asked == ["reload-preview", "reload"]


def test_an_editor_is_opened_with_a_warning(
    agent: Agent,
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(config, "open_in_editor", opened.append)
    edit(recording.with_name("settings.toml"))
    assert f"a recording goes on, to {recording}" in capsys.readouterr().err
    assert len(opened) == 1
    assert not agent.asked


def entry(unit: str, **more: object) -> DeviceSettings:
    table = {"sensor": "polar_h10", "unit": unit, "device": f"AA:BB:CC:DD:EE:0{unit}", **more}
    return settings_models()["polar_h10"].model_validate(table)


def test_a_preview_says_what_a_change_would_do() -> None:
    devices = [entry("1"), entry("2"), entry("3")]
    fleet = DeviceSet({each: Device.from_settings(each) for each in devices}, Room.here())
    wanted = [devices[0], entry("2", participant="P02"), entry("4"), entry("5", enabled=False)]
    assert fleet.preview(wanted) == DeviceChanges(
        added=("polar_h10/4",),
        removed=("polar_h10/3",),
        restarted=("polar_h10/2",),
        kept=("polar_h10/1",),
    )
    assert [each.name for each in fleet] == ["polar_h10/1", "polar_h10/2", "polar_h10/3"]


# An empty argument is a variable that a script did not set, not "as usual".


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--simulate", ""], "'--simulate' is empty"),
        (["record", "start", "--folder="], "'--folder' is empty"),
        (["withdraw", "", "."], "'withdraw' is empty"),
        (["doctor", "--with", ""], "'--with' is empty"),
        (["doctor", "--code", "123456"], "--code needs --with"),
    ],
)
def test_an_empty_or_lonely_argument_is_refused(
    arguments: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *arguments])
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == EXIT_USAGE
    assert said in capsys.readouterr().err
