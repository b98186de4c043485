"""The command line, but for ``run``: what it prints, and how it exits."""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import random
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import psutil
import pytest
import serial
from typer.core import TyperGroup

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.cli.app import COMMANDS, Deferred, app
from biosensor_gateway.demo import virtual_devices as simulate
from biosensor_gateway.devices.polar_h10.driver import PolarH10Settings
from biosensor_gateway.devices.registry import sensor, sensor_names
from biosensor_gateway.settings.places import STATE_VARIABLE
from tests.rigs.gateway import cli_process
from tests.rigs.polling import wait_until
from tests.rigs.zephyr import SteeredBioHarness

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]

DEVICE: dict[str, Any] = {
    "sensor": "zephyr",
    "unit": "BHT012345",
    "participant": "p01",
    "label": "",
    "state": "streaming",
    "error": None,
    "paused": False,
    "streams": {
        "p01@zephyr-ecg": {
            "pushed": 4711,
            "lost": 63,
            "refused": 5,
            "withheld": 8,
            "last_stamp": 1.0,
        }
    },
}


def one_sentence(outcome: Outcome, code: int) -> str:
    assert outcome.code == code
    assert outcome.out == ""
    assert outcome.err.startswith("biosensor-gateway: ")
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err
    return outcome.err


def write_status(
    state: Path, *devices: dict[str, Any], age_s: float = 0.0, process: int = 1
) -> None:
    written = {"written": time.time() - age_s, "process": process, "devices": list(devices)}
    status_file.write_status(state, written)


def test_the_version_is_the_distribution_s(run: Run) -> None:
    assert run("--version") == (0, f"biosensor-gateway {version('biosensor-gateway')}\n", "")


@pytest.mark.parametrize("arguments", [("fly",), ("run", "--high"), ("config", "eat")])
def test_a_wrong_command_is_a_usage_error(run: Run, arguments: tuple[str, ...]) -> None:
    outcome = run(*arguments)
    assert outcome.code == 2
    assert arguments[-1] in outcome.err


def test_config_path_says_where_the_settings_are(run: Run, settings: Path) -> None:
    assert run("config", "path") == (0, f"{settings}\n", "")


@pytest.mark.nightly
def test_a_letter_that_the_output_does_not_have_is_escaped() -> None:
    named = subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", "config", "path"],
        env={
            **os.environ,
            "PYTHONIOENCODING": "cp1252",
            "BIOSENSOR_GATEWAY_SETTINGS": "/Łukasz/größer.toml",
        },
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert named.stdout.decode("cp1252") == f"/\\u0141ukasz/größer.toml{os.linesep}"
    assert (named.returncode, named.stderr) == (0, b"")


def test_config_init_writes_settings_that_config_check_accepts(run: Run, settings: Path) -> None:
    written = run("config", "init")
    assert (written.code, written.err) == (0, "")
    assert str(settings) in written.out
    if os.name == "posix":
        assert settings.parent.stat().st_mode & 0o077 == 0
    checked = run("config", "check")
    assert checked == (0, f"{settings}: 0 devices, no problem found\n", "")


def test_config_init_overwrites_nothing(run: Run, settings: Path) -> None:
    settings.parent.mkdir()
    settings.write_text("# mine\n")
    assert str(settings) in one_sentence(run("config", "init"), 2)
    assert settings.read_text() == "# mine\n"


def test_other_settings_can_be_named(run: Run, settings: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    assert run("config", "init", "--settings", str(other)).code == 0
    assert run("config", "check", "--settings", str(other)).code == 0
    assert not settings.exists()


@pytest.mark.parametrize("command", [("config", "check"), ("run",)])
def test_without_settings_it_says_how_to_make_them(
    run: Run, settings: Path, command: tuple[str, ...]
) -> None:
    sentence = one_sentence(run(*command), 2)
    assert str(settings) in sentence
    assert "config init" in sentence


@pytest.mark.parametrize("command", [("config", "check"), ("run",)])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lsl\n", "not valid TOML"),
        ('[lsl]\nsesion_id = "a"\n', "sesion_id"),
        ('[lsl]\nport_range = "many"\n', "port_range"),
        ('[[device]]\nsensor = "zephyr"\nunit = "1"\n', "port"),
        ('[[device]]\nsensor = "zephir"\nunit = "1"\n', "zephir"),
    ],
)
def test_wrong_settings_are_refused_with_file_and_line(
    run: Run, settings: Path, command: tuple[str, ...], text: str, words: str
) -> None:
    settings.parent.mkdir()
    settings.write_text(text)
    outcome = run(*command)
    assert outcome.code == 2
    assert words in outcome.err
    assert str(settings) in outcome.err
    assert "line" in outcome.err or f"{settings}:" in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize("name", ["toaster", "zephyr,toaster", "all,toaster", "all, toaster"])
def test_a_virtual_device_that_does_not_exist_is_named(run: Run, name: str) -> None:
    sentence = one_sentence(run("run", "--simulate", name), 2)
    assert "toaster'" in sentence
    assert "zephyr:recording" in sentence


def test_each_use_of_an_option_for_virtual_devices_counts(run: Run) -> None:
    sentence = one_sentence(run("run", "--simulate", "toaster", "--simulate", "zephyr"), 2)
    assert "toaster'" in sentence


ALL = [name for name in sensor_names() if sensor(name).virtual]


@pytest.mark.parametrize(
    ("names", "expected"),
    [(["all"], ALL), (["zephyr", "zephyr"], ["zephyr"]), (["all", "zephyr"], ALL)],
)
def test_each_virtual_device_runs_once(names: list[str], expected: list[str]) -> None:
    with simulate.simulated_settings(names) as settings:
        assert [device.sensor for device in settings.devices] == expected


def test_people_wear_virtual_devices_of_their_own() -> None:
    names = ["all@P01", "polar_h10@P02", "zephyr:recording@P02", "polar_h10@P01"]
    with simulate.simulated_settings(names) as settings:
        devices = list(settings.devices)
    assert [device.sensor for device in devices] == [*ALL, "polar_h10", "zephyr"]
    assert [device.participant for device in devices] == ["P01"] * len(ALL) + ["P02"] * 2
    first, second = (each.device for each in devices if isinstance(each, PolarH10Settings))
    assert first != second


def test_a_name_that_no_participant_can_have_is_refused(run: Run) -> None:
    sentence = one_sentence(run("run", "--simulate", f"polar_h10@{'x' * 33}"), 2)
    assert "cannot be a participant's name: use 1 to 32 letters and digits" in sentence


@pytest.mark.nightly
def test_a_virtual_device_says_which_package_it_needs(tmp_path: Path) -> None:
    before = "import sys; sys.modules['bumble'] = None"
    arguments = ("run", "--simulate", "polar_h10")
    with cli_process(tmp_path, *arguments, before=before) as process:
        assert process.wait(30) == 2
    assert "the virtual polar_h10 needs bumble" in (tmp_path / "stderr.txt").read_text()


def test_status_without_an_agent_fails(run: Run) -> None:
    assert "no agent is running" in one_sentence(run("status"), 1)
    assert "no agent is running" in one_sentence(run("status", "--json"), 1)


# From the future if the clock was set back since.
@pytest.mark.parametrize("age_s", [90, -99])
def test_status_of_an_agent_that_is_gone_fails(run: Run, state: Path, age_s: float) -> None:
    write_status(state, DEVICE, age_s=age_s)
    assert re.search(r"\b9\d s ago", one_sentence(run("status"), 1))


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["status", "clocks"])
def test_an_agent_that_was_killed_streams_no_more(run: Run, state: Path, command: str) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as agent:
        write_status(state, {**DEVICE, "clock": None}, process=agent.pid)
        assert run(command).code == 0
        agent.kill()
        # Whoever started it need not have asked yet how it ended.
        while psutil.Process(agent.pid).status() != psutil.STATUS_ZOMBIE:
            time.sleep(0.01)
        assert "ended without a message" in one_sentence(run(command), 1)
    assert "ended without a message" in one_sentence(run(command), 1)
    # In another container its number says nothing, but its lock does.
    with single_instance(state):
        assert run(command).code == 0


def test_status_of_an_agent_without_devices_says_so(run: Run, state: Path) -> None:
    write_status(state)
    outcome = run("status")
    assert (outcome.code, outcome.err) == (0, "")
    assert "no device is enabled" in outcome.out
    assert "config edit" in outcome.out


def test_a_damaged_status_file_fails(run: Run, state: Path) -> None:
    state.mkdir()
    (state / status_file.STATUS_FILE).write_text("{")
    assert str(state) in one_sentence(run("status"), 1)


def test_status_says_what_became_of_samples_in_a_persons_words(run: Run, state: Path) -> None:
    write_status(state, DEVICE)
    *_, titles, row = run("status").out.strip().splitlines()
    assert re.findall(r"\w+", titles) == ["stream", "sent", "lost", "refused", "paused"]
    assert row.split()[1:] == ["4711", "63", "5", "8"]


def test_status_for_scripts_is_json(run: Run, state: Path) -> None:
    write_status(state, DEVICE)
    outcome = run("status", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    assert json.loads(outcome.out)["devices"] == [DEVICE]


def test_status_for_people_names_devices_states_and_counts(run: Run, state: Path) -> None:
    absent: dict[str, Any] = {
        **DEVICE,
        "participant": "",
        "label": "[left]",
        "state": "discovering",
        "paused": True,
        "error": "COM7: there is no such port",
        "streams": {},
    }
    write_status(state, DEVICE, absent)
    outcome = run("status")
    assert outcome.code == 0
    assert "p01 zephyr (BHT012345): streaming\n" in outcome.out
    shown = "zephyr [left] (BHT012345): paused (looking for it) - COM7: there is no such port"
    assert shown in outcome.out
    row = next(line.split() for line in outcome.out.splitlines() if "4711" in line)
    assert row == ["p01@zephyr-ecg", "4711", "63", "5", "8"]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("biosensor-gateway rel", ["reload"]),
        ("biosensor-gateway record st", ["start", "stop", "status"]),
        ("biosensor-gateway record start --fo", ["--folder"]),
    ],
)
def test_what_is_begun_is_completed(
    typed: str,
    offered: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("_BIOSENSOR_GATEWAY_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(typed.count(" ")))
    with pytest.raises(SystemExit) as ended:
        app()(args=[], prog_name="biosensor-gateway")
    assert ended.value.code == 0
    assert capsys.readouterr().out.split() == offered


# The doors of the program: what is imported before it is known what is wanted.

# What takes a tenth of a second and more, each or with what it brings.
HEAVY = {
    "asyncio",
    "bleak",
    "keyring",
    "numpy",
    "psutil",
    "pydantic",
    "pylsl",
    "serial",
    "structlog",
    "tomlkit",
    "websockets",
}
OURS = {
    "biosensor_gateway",
    "biosensor_gateway.cli",
    "biosensor_gateway.cli.app",
    "biosensor_gateway.system",
    "biosensor_gateway.system.windows_console",
}
LOADED_AT_THE_END = """
import atexit, sys
atexit.register(lambda: sys.stderr.write(" ".join(sys.modules)))
from biosensor_gateway.cli import main
main()
"""

each_command = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)


def loaded(*arguments: str, expected: int = 0) -> set[str]:
    """Modules that a run of the program has imported."""
    ended = subprocess.run(
        [sys.executable, "-c", LOADED_AT_THE_END, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == expected, ended.stderr
    return set(ended.stderr.split())


@pytest.mark.seam
@pytest.mark.parametrize(
    ("option", "more"), [("--version", {"rich"}), ("--help", {"pygments", "rich.markdown"})]
)
def test_the_first_look_imports_no_command(option: str, more: set[str]) -> None:
    modules = loaded(option)
    assert "typer" in modules
    assert not (HEAVY | more) & modules
    assert {name for name in modules if name.startswith("biosensor_gateway")} <= OURS


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["run", "stop", "pause", "resume", "status", "demo"])
def test_the_help_of_a_command_imports_no_agent(name: str) -> None:
    # Typer itself takes pydantic for each argument; run heeds signals from its first moment on.
    known = {"pydantic", "asyncio"} if name == "run" else {"pydantic"}
    assert not ((HEAVY | {"pygments", "rich.markdown"}) - known) & loaded(name, "--help")


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["stop", "pause zephyr", "resume zephyr", "status"])
def test_who_asks_the_agent_imports_none(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STATE_VARIABLE, str(tmp_path))
    modules = loaded(*command.split(), expected=1)
    assert "biosensor_gateway.settings.places" in modules
    assert not (HEAVY - {"pydantic"}) & modules
    assert "biosensor_gateway.settings.models" not in modules


@each_command
def test_the_list_says_what_the_command_says_of_itself(command: Deferred) -> None:
    text = inspect.cleandoc(command.load().help or "")
    assert command.first_lines() == text.partition("\n\n")[0] != ""


def test_the_program_has_the_commands_of_the_table() -> None:
    assert list(app().commands.values()) == list(COMMANDS)
    assert len({command.name for command in COMMANDS}) == len(COMMANDS)


@each_command
def test_help_is_wrapped_by_the_console_alone(command: Deferred) -> None:
    """Lines of the source are longer than a console of 80 columns, which would wrap them again."""
    waiting = [command.load()]
    while waiting:
        found = waiting.pop()
        assert "\n" not in (found.help or "").replace("\n\n", ""), found.name
        waiting += found.commands.values() if isinstance(found, TyperGroup) else ()


ROOT = Path(__file__).parents[2]


@pytest.mark.seam
def test_every_help_is_shown_and_every_use_says_one_sentence(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.gateway.without_liblsl"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
    said: dict[str, dict[str, list[Any]]] = json.loads(ended.stdout)
    assert len(said["helps"]) > 40
    assert {command: each for command, each in said["helps"].items() if each != [0, ""]} == {}
    assert len(said["uses"]) > 4
    for command, (code, sentence) in said["uses"].items():
        assert code == 1, (command, sentence)
        assert sentence.startswith("biosensor-gateway: liblsl, the library"), command
        assert sentence.count("\n") == 1, command
        assert "pip install" in sentence or "PYLSL_LIB" in sentence, command


# Bad devices beside a good one: each is named with its fault, and the good one streams on.


# What a serial line of 115200 baud carries in a twentieth of a second.
GARBAGE_BYTES, GARBAGE_EVERY_S = 576, 0.05


class Lab(NamedTuple):
    """A running agent with one good device and four bad ones."""

    folder: Path
    process: subprocess.Popen[bytes]
    ports: dict[str, str]

    def device(self, unit: str) -> dict[str, Any]:
        with contextlib.suppress(ConfigError):
            for device in status_file.read_status(self.folder)["devices"]:
                if device["unit"] == unit:
                    return device
        return {}

    def lines_with(self, text: str) -> list[str]:
        """Lines of the log."""
        log = (self.folder / "stderr.txt").read_text()
        return [line for line in log.splitlines() if text in line]

    def pushed(self) -> int:
        streams = self.device("good").get("streams", {})
        return streams.get("zephyr-good-ecg", {}).get("pushed", 0)


@pytest.fixture(scope="module")
def ports(tmp_path_factory: pytest.TempPathFactory) -> Generator[dict[str, str]]:
    masters: list[int] = []

    def terminal() -> str:
        master, slave = os.openpty()
        masters.extend((master, slave))
        return os.ttyname(slave)

    mute, held, noisy = terminal(), terminal(), terminal()
    over = threading.Event()
    babble = threading.Thread(target=babbling, args=(masters[4], over))
    babble.start()
    with serial.Serial(held, exclusive=True), SteeredBioHarness() as good:
        yield {
            "good": good.port,
            "absent": str(tmp_path_factory.mktemp("ports") / "ttyUSB9"),
            "held": held,
            "noisy": noisy,
            "mute": mute,
        }
    over.set()
    babble.join()
    for handle in masters:
        os.close(handle)


def babbling(master: int, over: threading.Event) -> None:
    """Write random bytes to whoever listens."""
    os.set_blocking(master, False)
    noise = random.Random(1)
    while not over.wait(GARBAGE_EVERY_S):
        with contextlib.suppress(BlockingIOError):
            os.write(master, noise.randbytes(GARBAGE_BYTES))


@pytest.fixture(scope="module")
def lab(ports: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Generator[Lab]:
    folder = tmp_path_factory.mktemp("lab")
    path = folder / "settings.toml"
    path.write_text(
        "".join(
            f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{port}"\n'
            for unit, port in ports.items()
        )
    )
    with cli_process(folder, "run", "--settings", str(path)) as process:
        yield Lab(folder, process, ports)
        process.terminate()
        assert process.wait(15.0) == 0
    assert "Traceback" not in (folder / "stderr.txt").read_text()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("unit", "reason", "words"),
    [
        ("absent", "absent", "there is no such port"),
        ("held", "busy", "another program is using the port"),
        ("noisy", "garbage", "the device that answers is not a BioHarness"),
        ("mute", "no_reply", "the device does not answer"),
    ],
)
def test_a_bad_device_is_named_with_its_fault_and_disturbs_no_other(
    lab: Lab, unit: str, reason: str, words: str
) -> None:
    wait_until(lambda: words in (lab.device(unit).get("error") or ""))
    error: str = lab.device(unit)["error"]
    assert error.startswith(f"{lab.ports[unit]}: ")
    # The log is written by a thread of its own.
    wait_until(lambda: bool(lab.lines_with(error)))
    (line,) = lab.lines_with(error)
    assert "warning" in line
    assert f"unit={unit!r}" in line
    assert f"reason={reason!r}" in line
    wait_until(lambda: lab.pushed() > 0)
    pushed = lab.pushed()
    wait_until(lambda: lab.pushed() > pushed)
    good = lab.device("good")
    assert (good["state"], good["connections"], good["error"]) == ("streaming", 1, None)
    assert all(counters["lost"] == 0 for counters in good["streams"].values())


@pytest.mark.nightly
def test_a_device_that_was_put_right_streams_without_anybody_s_help(lab: Lab) -> None:
    with SteeredBioHarness() as repaired:
        Path(lab.ports["absent"]).symlink_to(repaired.port)
        wait_until(lambda: lab.device("absent").get("state") == "streaming")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lsl\n", ["line 1", "not valid TOML"]),
        ('[lsl]\nsesion_id = "a"\n', ["line 2", "lsl.sesion_id", "unknown"]),
        ('[lsl]\nport_range = "many"\n', ["line 2", "lsl.port_range", "integer"]),
        (
            '[[device]]\nsensor = "zephyr"\nunit = 7\nport = "COM7"\n',
            ["line 3", "device.unit", "text in quotes"],
        ),
    ],
)
def test_bad_settings_are_a_usage_error_that_says_what_and_where(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    with cli_process(tmp_path, "run", "--settings", str(path)) as process:
        assert process.wait(30.0) == 2
    told = (tmp_path / "stderr.txt").read_text()
    assert told.count("\n") == 1
    assert told.startswith(f"biosensor-gateway: {path}")
    assert [word for word in words if word not in told] == []
