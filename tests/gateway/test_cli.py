"""The command line, but for ``run``: what it prints, and how it exits."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest

from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.cli.app import app
from biosensor_gateway.demo import virtual_devices as simulate
from biosensor_gateway.devices.polar_h10.driver import PolarH10Settings
from biosensor_gateway.devices.registry import sensor, sensor_names

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
def test_a_virtual_device_says_which_package_it_needs(
    cli_process: Callable[..., Any], tmp_path: Path
) -> None:
    before = "import sys; sys.modules['bumble'] = None"
    arguments = ("run", "--simulate", "polar_h10")
    with cli_process(tmp_path, *arguments, before=before) as process:
        assert process.wait(30) == 2
    assert "the virtual polar_h10 needs bumble" in (tmp_path / "stderr.txt").read_text()


def test_status_without_an_agent_fails(run: Run) -> None:
    assert "no agent is running" in one_sentence(run("status"), 1)
    assert "no agent is running" in one_sentence(run("status", "--json"), 1)


def test_status_of_an_agent_that_is_gone_fails(run: Run, state: Path) -> None:
    write_status(state, DEVICE, age_s=90)
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
        assert "ended silently" in one_sentence(run(command), 1)
    assert "ended silently" in one_sentence(run(command), 1)
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
