"""Commands that refuse, and those that ask before something goes on without a sensor."""

from __future__ import annotations

import builtins
import errno
import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pylsl
import pytest
import typer

from biosensor_common.errors import ConfigError, ConfigReason, TransportError
from biosensor_common.naming import source_id
from biosensor_common.process_limits import INTERRUPTED
from biosensor_common.refusal import LATELY_S, Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway import cli
from biosensor_gateway.agent import control, status_file
from biosensor_gateway.agent.agent import problems_of, snapshot
from biosensor_gateway.agent.device_set import Device, DeviceChanges, DeviceSet
from biosensor_gateway.agent.device_states import holders, unique_names
from biosensor_gateway.agent.pauses import PauseCommands, load_pauses
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.cli import agent as commands
from biosensor_gateway.cli import agent_process, app, config, output, page, record
from biosensor_gateway.cli.app import EXIT_FAILED, EXIT_USAGE, refusal
from biosensor_gateway.cli.config import edit
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.devices.registry import declaration, settings_models
from biosensor_gateway.page.routes.devices import last_lines
from biosensor_gateway.page.routes.recording import Story
from biosensor_gateway.recording.recorder.presence import expected_devices
from biosensor_gateway.recording.recorder.request import (
    By,
    LocalStatus,
    RecordingRequest,
    SensorsAwayError,
)
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.settings.places import SETTINGS_VARIABLE, STATE_VARIABLE
from biosensor_gateway.simulation.async_serial import PtyPort
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import device_facts
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.device_log import names_in_log
from biosensor_gateway.system.keep_alive import RESTARTS
from biosensor_gateway.system.logs import configure_logs, flush_logs
from tests.gateway.test_new_file import NoDriver
from tests.rigs.gateway import recording_going_on
from tests.rigs.kept_logging import kept_logging
from tests.rigs.memory_links import MemoryOutlet
from tests.xdf.checking import codes, text_of
from tests.xdf.test_participants import judged

# What the system refuses is one sentence, not a traceback.


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "/home/x/.local/state: "),
        (errno.EROFS, "set BIOSENSOR_GATEWAY_STATE to another folder"),
        (errno.ENOSPC, "/home/x/.local/state: "),
        (errno.EMFILE, "no more files can be opened: this computer lets a program open"),
    ],
)
def test_what_the_system_refuses_is_said_with_what_to_do(
    code: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STATE_VARIABLE, "/home/x/.local/state/gateway")
    assert words in refusal(OSError(code, "refused", "/home/x/.local/state"))


@pytest.mark.parametrize(
    "error",
    [BlockingIOError(errno.EAGAIN, "fork"), RuntimeError("can't start new thread")],
    ids=["program", "thread"],
)
def test_a_limit_of_threads_and_programs_is_said(error: OSError | RuntimeError) -> None:
    assert "ulimit -u" in refusal(error)


def test_what_should_not_happen_keeps_its_traceback() -> None:
    assert refusal(RuntimeError("dictionary changed size during iteration")) == ""
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
@pytest.mark.usefixtures("logging_as_before")
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
    with recording_going_on(tmp_path) as file:
        yield file


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Have somebody at a terminal who answers."""

    def answers(text: str) -> None:
        def typed(_question: str) -> str:
            return text

        monkeypatch.setattr(output, "can_ask", lambda: True)
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


def test_who_ends_the_page_or_the_agent_is_told_that_a_recording_goes_on(
    agent: Agent,
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def ends(*_: object) -> str:
        return "the agent has ended"

    monkeypatch.setattr(page, "ask_to_end", ends)
    page.page(end=True)
    first, second = capsys.readouterr().out.splitlines()
    assert first == "the page has ended"
    assert second == (
        f"the recording goes on, to {recording}; end and check it: biosensor-gateway record stop"
    )
    monkeypatch.setattr(commands, "stop_agent", ends)
    commands.stop(while_recording=True)
    assert capsys.readouterr().out.splitlines() == ["the agent has ended", second]


def test_an_editor_is_opened_with_a_warning(
    agent: Agent,
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(config, "open_in_editor", opened.append)
    edit(recording.with_name("settings.toml"))
    assert f"a recording is running, to {recording}" in capsys.readouterr().err
    assert len(opened) == 1
    assert not agent.asked


def entry(unit: str, **more: object) -> DeviceSettings:
    table = {"sensor": "polar_h10", "unit": unit, "device": f"AA:BB:CC:DD:EE:0{unit}", **more}
    return settings_models()["polar_h10"].model_validate(table)


@pytest.fixture
def of_two(recording: Path, tmp_path: Path) -> list[DeviceSettings]:
    """Have the recording begun with two straps; return one of them."""
    strap, other = entry("1"), entry("2")
    required = tuple(source_id(each.identity, "ecg") for each in (strap, other))
    RecorderFolder(tmp_path).save(SavedRecording(str(recording), required, 1.0))
    return [strap]


def _start(devices: list[DeviceSettings], folder: Path, **options: bool) -> str:
    settings = GatewaySettings().model_copy(update={"devices": devices})
    options = {"may_ask": True, "confirmed": False} | options
    return str(agent_process.confirm_start(settings, folder, **options) or "")


def test_a_start_that_costs_a_sensor_is_refused_without_a_terminal(
    of_two: list[DeviceSettings], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="--while-recording") as caught:
        _start(of_two, tmp_path)
    assert caught.value.reason is ConfigReason.IN_USE
    assert "no longer have polar_h10-2" in str(caught.value)
    # Who confirms it finds it in the log; whoever starts all sensors is not asked.
    assert "no longer have polar_h10-2" in _start(of_two, tmp_path, confirmed=True)
    assert not _start([*of_two, entry("2")], tmp_path)


@pytest.mark.parametrize("typed", ["", "2"])
def test_at_a_terminal_a_start_that_costs_a_sensor_is_asked_about(
    of_two: list[DeviceSettings], tmp_path: Path, answers: Callable[[str], None], typed: str
) -> None:
    answers(typed)
    if typed:
        assert "no longer have polar_h10-2" in _start(of_two, tmp_path)
    else:
        with pytest.raises(typer.Exit) as caught:
            _start(of_two, tmp_path)
        assert caught.value.exit_code == 2
    with pytest.raises(ConfigError):
        _start(of_two, tmp_path, may_ask=False)


def test_a_supervisor_starts_the_other_sensors_and_the_log_says_what_is_lost(
    of_two: list[DeviceSettings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(RESTARTS, "0")
    assert "no longer have polar_h10-2" in _start(of_two, tmp_path)


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
        (["run", "--fault", "drop:5s@1s"], "add --simulate"),
    ],
)
@pytest.mark.usefixtures("logging_as_before")
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


# Two people wear virtual devices of one kind: what is known of one is never said of the other.

FIRST, SECOND = (DeviceIdentity("polar_h10", "virtual", each) for each in ("P01", "P02"))
OTHER = DeviceIdentity("zephyr", "virtual", "P01")


def device(identity: DeviceIdentity) -> Device:
    sink = DeviceSink(identity, declaration(identity.sensor))
    sink.open(DeviceInfo(), {})
    return Device(Supervisor(NoDriver, sink), sink)


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> list[Device]:
    monkeypatch.setattr(outlets, "LslOutlet", MemoryOutlet)
    return [device(FIRST), device(SECOND)]


def test_names_are_those_of_before_where_they_are_unique() -> None:
    assert unique_names([FIRST, OTHER]) == ["polar_h10/virtual", "zephyr/virtual"]
    names = ["polar_h10/virtual (P01)", "polar_h10/virtual (P02)", "zephyr/virtual"]
    assert unique_names([FIRST, SECOND, OTHER]) == names
    for name, each in zip(names, (FIRST, SECOND, OTHER), strict=True):
        assert holders(name, [FIRST, SECOND, OTHER]) == (each,)
    # A recording of before had one name for both.
    assert holders("polar_h10/virtual", [FIRST, SECOND, OTHER]) == (FIRST, SECOND)
    assert holders("polar_h10/virtual (P02)", [FIRST]) == ()


def test_what_is_wrong_with_one_is_told_of_that_one(two: list[Device]) -> None:
    two[1].sink.left_out(3, why="it is not known")
    named = dict(zip(unique_names([FIRST, SECOND]), two, strict=True))
    (told,) = problems_of(named, Refusals(), [], LATELY_S).items()
    assert told[0] == "polar_h10/virtual (P02)"


def test_both_take_room(two: list[Device]) -> None:
    entries = [DeviceSettings(sensor="polar_h10", unit=unit) for unit in ("a", "b")]
    devices = DeviceSet(dict(zip(entries, two, strict=True)), Room(two[0].streams))
    devices.make_room()
    assert devices.with_room == two[:1]


def heartbeat(at: float, first: str, second: str) -> dict[str, object]:
    states = dict(zip(unique_names([FIRST, SECOND]), (first, second), strict=True))
    return {"event": "heartbeat", "devices": states, "lsl_time": at}


def test_a_recording_tells_who_was_paused() -> None:
    paused = {"event": EventKind.PAUSED, **device_facts(SECOND), "lsl_time": 1012.0}
    events: list[object] = [heartbeat(1001.0, "streaming", "streaming"), paused]
    report = judged("group1", FIRST, SECOND, events=events)
    assert codes(report, Level.WARNING) == {("away", "")}
    assert text_of(report, "away") == "polar_h10/virtual of P02 was paused from 12.0 s to the end"


def test_a_recording_without_one_of_them_says_so() -> None:
    events: list[object] = [heartbeat(1001.0, "streaming", "streaming")]
    report = judged("P01", FIRST, events=events)
    assert codes(report, Level.ERROR) == {("left-out", "")}
    assert text_of(report, "left-out").startswith("the agent also had polar_h10/virtual (P02)")


def test_the_recorder_waits_for_the_one_that_streams(tmp_path: Path, two: list[Device]) -> None:
    status = snapshot(two).model_dump()
    status["devices"][0]["state"] = "streaming"
    status_file.write_status(tmp_path, status)
    first, second = expected_devices(GatewaySettings(), tmp_path)
    assert not first.away
    assert second.away.startswith("P02's ")


def test_the_page_tells_who_is_back() -> None:
    story = Story()

    def told(*states: str) -> list[str]:
        identities = (FIRST, SECOND)
        facts: list[dict[str, object]] = [
            {"sensor": each.sensor, "unit": each.unit, "participant": each.participant,
             "label": "", "state": state, "paused": False, "error": None,
             "since": time.time(), "streams": {}}
            for each, state in zip(identities, states, strict=True)
        ]  # fmt: skip
        standing = LocalStatus(by=By.GATEWAY, recording=True, file=Path("/a.xdf"), started=1.0)
        story.look(facts, standing)
        return story.notes

    assert told("enabling", "enabling") == []
    (note,) = told("streaming", "enabling")
    assert note.startswith("P01's ")
    assert len(told("streaming", "streaming")) == 2


async def test_the_pause_of_one_is_kept_while_another_is_resumed(
    tmp_path: Path, two: list[Device]
) -> None:
    nobody = device(DeviceIdentity("polar_h10", "virtual"))
    sinks = [nobody.sink, two[0].sink]
    commands = PauseCommands(tmp_path, lambda: sinks).commands
    await commands["pause"]({"device": "polar_h10/virtual (P01)"})
    assert [each.is_paused for each in sinks] == [False, True]
    await commands["resume"]({"device": "polar_h10/virtual"})
    assert [each.identity for each in load_pauses(tmp_path)] == [FIRST]
    again = [device(nobody.sink.identity).sink, device(FIRST).sink]
    PauseCommands(tmp_path, lambda: again)
    assert [each.is_paused for each in again] == [False, True]


@pytest.mark.usefixtures("two")
def test_the_log_tells_whose_device_it_is_about(tmp_path: Path) -> None:
    with kept_logging(), simulated_settings(["polar_h10@P01", "polar_h10@P02"]) as settings:
        configure_logs(settings.log, tmp_path)
        for entry, data_name in zip(settings.devices, ("hr", "ibi"), strict=True):
            sink = Device.from_settings(entry).sink
            sink.open(DeviceInfo(), {})
            # Which is refused, as it has two values too many.
            sink.emit_at(data_name, [[1.0, 2.0, 3.0]], [sink.clock()])
        flush_logs()
    for identity, data_name in ((FIRST, "hr"), (SECOND, "ibi")):
        (line,) = last_lines(tmp_path, identity).lines
        assert f"data {data_name}" in line.sentence
    # A unit of the settings is that of one device, so pseudonyms stay out of the log.
    assert names_in_log(FIRST) == {"sensor": "polar_h10", "unit": "virtual"}


def test_refusals_last_until_the_next_heartbeat() -> None:
    now = 0.0
    refusals = Refusals(clock=lambda: now)
    refusals.refuse(Refusal.GARBLED, 3)
    now = 45.0
    assert refusals.present == []
    assert len(refusals.within(60.0)) == 1


def test_ctrl_c_during_the_imports_prints_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "main", interrupt)
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", "status"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == INTERRUPTED


@pytest.mark.parametrize("command", ["status", "doctor", "run", "record status", "scan", "try"])
@pytest.mark.usefixtures("logging_as_before")
def test_a_user_without_a_home_folder_is_told_so(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def has_none(_: object = None) -> Path:
        raise RuntimeError("Could not determine home directory.")

    for variable in (STATE_VARIABLE, SETTINGS_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(Path, "home", has_none)
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *command.split()])
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code in (EXIT_FAILED, EXIT_USAGE)
    said = capsys.readouterr().err
    assert said.startswith("biosensor-gateway: this user has no home folder; set HOME to ")
    assert said.count("\n") == 1


_OUTLETS = """
import pylsl
from biosensor_common.errors import TransportError
from biosensor_common.lsl.outlet import LslOutlet
kept = []
try:
    while len(kept) < 9:
        kept.append(LslOutlet(pylsl.StreamInfo("x-1-ecg", "ECG", 1, 130, "float32", "x-1-ecg")))
except TransportError as error:
    print(len(kept), error)
"""


@pytest.mark.seam
def test_where_no_port_is_left_a_stream_says_so(tmp_path: Path) -> None:
    file = tmp_path / "lsl_api.cfg"
    file.write_text("[ports]\nBasePort = 17572\nPortRange = 2\nAllowRandomPorts = 0\n")
    done = subprocess.run(
        [sys.executable, "-c", _OUTLETS],
        env={**os.environ, "LSLAPICFG": str(file)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "liblsl cannot open the stream x-1-ecg: all of its ports are taken" in done.stdout


async def test_a_virtual_port_says_what_the_system_lacks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse() -> tuple[int, int]:
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(os, "openpty", refuse)
    port = PtyPort(lambda _: None, lambda: None, 4096)
    with pytest.raises(TransportError, match=r"no pseudo-terminal left .*: No such device; in a "):
        port.open()


# Two agents with one settings file.


@pytest.mark.seam
def test_another_agent_that_sends_the_same_sensor_is_told_until_it_ends() -> None:
    own, other = Refusals(), Refusals()
    ids = [f"P01@polar_h10.{each}-ecg" for each in ("twin", "alone")]
    infos = [pylsl.StreamInfo(each, "ECG", 1, 130.0, "int32", each) for each in ids]
    outlets = [pylsl.StreamOutlet(each) for each in infos]
    twin = [pylsl.StreamOutlet(infos[0])]
    watch = agent_process.TwinWatch(lambda: dict(zip(ids, (own, other), strict=True)))
    watch.look()
    assert [each.what for each in own.present] == [Refusal.EITHER_SENDER]
    assert other.present == []
    twin.clear()
    watch.look()
    assert own.present == []
    del outlets
