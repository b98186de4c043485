"""``clocks``, and how the state of a device's clock travels with the counters."""

from __future__ import annotations

import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import keyring
import pylsl
import pytest
from keyring.backends import fail

from biosensor_common.device_clock import ClockState, DeviceClock
from biosensor_common.ros.messages import read_counters
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import snapshot
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.xdf.counters import Reading, parse_readings
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.sink import DeviceSink
from tests.rigs import file_keyring
from tests.rigs.file_keyring import FileKeyring
from tests.rigs.gateway import cli_process

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome


Run = Callable[..., "Outcome"]

DEADLINE_S = 30.0
CLOCK = {
    "offset_s": -1795230819.108031,
    "drift_ppm": -38.04,
    "residual_rms_s": 0.0033,
    "reanchors": 2,
    "observations": 4711,
    "newest_s": 998.5,
}
DEVICE: dict[str, Any] = {
    "sensor": "zephyr",
    "unit": "BHT012345",
    "participant": "p01",
    "label": "[left]",
    "state": "streaming",
    "error": None,
    "clock": CLOCK,
    "streams": {},
}


def write_status(state: Path, *devices: dict[str, Any], **more: object) -> None:
    written = {"written": time.time(), "process": 1, "lsl_time": 1000.0, "devices": list(devices)}
    status_file.write_status(state, written | more)


def test_without_an_agent_it_fails(run: Run) -> None:
    for arguments in ((), ("--json",), ("--watch",), ("--watch", "--json")):
        outcome = run("clocks", *arguments)
        assert (outcome.code, outcome.out.strip()) == (1, "")
        assert "no agent is running" in outcome.err


def test_a_row_has_all_figures_of_a_clock_uncut(run: Run, state: Path) -> None:
    strap = {**DEVICE, "sensor": "ble_heart_rate", "label": "", "clock": None}
    absent = {**strap, "participant": "", "state": "discovering"}
    write_status(state, DEVICE, strap, absent)
    outcome = run("clocks")
    assert (outcome.code, outcome.err) == (0, "")
    assert "-1795230819.108031" in outcome.out
    rows = [line.split() for line in outcome.out.splitlines()]
    assert rows[0][:5] == ["device", "offset", "s", "drift", "ppm"]
    figures = ["-1795230819.108031", "-38.0", "3.300", "2", "1.50"]
    assert next(row for row in rows if row[0] == "p01")[-5:] == figures
    text = " ".join(outcome.out.split())
    assert "[left]" in text
    assert "none" in text
    assert "discovering" in text


def test_for_scripts_there_is_one_entry_a_device(run: Run, state: Path) -> None:
    write_status(state, DEVICE, {**DEVICE, "clock": None})
    outcome = run("clocks", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    first, second = json.loads(outcome.out)["clocks"]
    assert first["clock"] == {**CLOCK, "age_s": 1.5}
    assert (first["sensor"], first["participant"], first["label"]) == ("zephyr", "p01", "[left]")
    assert second["clock"] is None


def test_a_report_of_an_older_agent_has_no_age(run: Run, state: Path) -> None:
    older = {name: value for name, value in CLOCK.items() if name != "newest_s"}
    write_status(state, {**DEVICE, "clock": older})
    (entry,) = json.loads(run("clocks", "--json").out)["clocks"]
    assert entry["clock"] == {**older, "age_s": None}
    assert run("clocks").code == 0


@pytest.mark.nightly
def test_watching_reports_every_second_until_ctrl_c(tmp_path: Path) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr"):
        waiting = [sys.executable, "-m", "biosensor_gateway.cli", "wait-ready"]
        environment = os.environ | {"BIOSENSOR_GATEWAY_STATE": str(tmp_path)}
        subprocess.run(waiting, env=environment, check=True, capture_output=True)
        watching = subprocess.Popen(
            [*waiting[:-1], "clocks", "--watch", "--json"],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert watching.stdout is not None
        reports = [json.loads(watching.stdout.readline()) for _ in range(4)]
        watching.send_signal(signal.SIGINT)
        _, err = watching.communicate(timeout=DEADLINE_S)
    assert (watching.returncode, err) == (0, "")
    clocks = [report["clocks"][0]["clock"] for report in reports]
    assert clocks[-1]["observations"] > clocks[0]["observations"]
    # The virtual device's clock runs as this computer's; its packets hold a second at most.
    assert all(abs(clock["drift_ppm"]) < 250 for clock in clocks)
    assert all(-1.0 < clock["age_s"] < 5.0 for clock in clocks)
    assert clocks[-1]["reanchors"] == 0


def test_the_age_is_that_of_the_newest_sample() -> None:
    clock = DeviceClock()
    assert math.isnan(clock.state.newest_s)
    clock.observe(10.0, 110.0)
    clock.observe(11.0, 111.0)
    assert clock.state.newest_s == pytest.approx(clock.to_lsl(11.0))
    # A late packet is no newer one.
    clock.observe(10.5, 111.2)
    assert clock.state.newest_s == pytest.approx(111.0, abs=0.01)


def test_the_status_has_the_time_to_which_the_ages_belong(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"))
    sink.open(DeviceInfo(), {})
    now = pylsl.local_clock()
    sink.observe(5.0, now)
    taken = snapshot([]).lsl_time
    assert taken is not None
    assert taken - sink.clock_state.newest_s == pytest.approx(0.0, abs=DEADLINE_S)
    assert sink.clock_state.newest_s == pytest.approx(now)
    rates = {source.rpartition("-")[2]: rate for source, rate in sink.nominal_rates.items()}
    assert (rates["ecg"], rates["acc"], rates["hr"]) == (250, 50, 0)
    sink.close()


STATE = ClockState(-1795230819.1080315, 3.18160, 0.000271, 1, 9, 5.0)


def test_the_counters_carry_the_clock_once_a_device() -> None:
    counters = {"a-1-x": Counters(5, 4, 3, 2.5), "a-1-y": Counters(), "b-1-z": Counters()}
    unknown = ClockState(math.nan, math.nan, math.nan, 0, 0)
    text = counters_text(counters, {"a-1-x": STATE, "b-1-z": unknown})
    entries = json.loads(text)
    assert entries["a-1-x"] == {
        "pushed": 5,
        "lost": 4,
        "last_stamp": 2.5,
        "clock": {
            "offset_s": -1795230819.108032,
            "drift_ppm": 3.18,
            "residual_rms_s": 0.000271,
            "reanchors": 1,
        },
    }
    assert entries["a-1-y"].keys() == entries["b-1-z"].keys() == {"pushed", "lost", "last_stamp"}


def test_readers_of_the_counters_are_not_disturbed_by_it() -> None:
    text = counters_text({"a-1-x": Counters(5, 4, 3, 2.5)}, {"a-1-x": STATE})
    (entry,) = read_counters(text).values()
    assert (entry["pushed"], entry["lost"], entry["last_stamp"]) == (5, 4, 2.5)
    readings, unreadable = parse_readings([text])
    assert (unreadable, list(readings)) == (0, ["a-1-x"])
    assert readings["a-1-x"] == [Reading(5, 4, 2.5)]


# ``biosensor-gateway secrets``: what it asks, stores and forgets, and what it never shows.

SENSOR = "emotiv_insight"
CLIENT_ID, CLIENT_SECRET = "planted-id-2b77", "planted-secret-94e1"
STORED = {
    "biosensor-gateway/emotiv_insight.client_id": CLIENT_ID,
    "biosensor-gateway/emotiv_insight.client_secret": CLIENT_SECRET,
}
QUESTIONS = ("The client id of the Cortex app: ", "The client secret of the Cortex app: ")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """The keyring of this process and of those that it starts; empty."""
    path = tmp_path / "keyring.json"
    for variable in ("EMOTIV_CLIENT_ID", "EMOTIV_CLIENT_SECRET"):
        monkeypatch.delenv(variable, raising=False)
    for variable, text in file_keyring.environment(path).items():
        monkeypatch.setenv(variable, text)
    before = keyring.get_keyring()
    keyring.set_keyring(FileKeyring())
    yield path
    keyring.set_keyring(before)


@pytest.fixture
def no_keyring(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del store
    monkeypatch.setenv("PYTHON_KEYRING_BACKEND", "keyring.backends.fail.Keyring")
    keyring.set_keyring(fail.Keyring())


class Terminal:
    """``secrets set`` at a terminal: what it shows, and what is typed."""

    def __init__(self, *arguments: str) -> None:
        self._ours, theirs = os.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "biosensor_gateway.cli", "secrets", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
        )
        os.close(theirs)
        self.shown = ""

    def await_text(self, text: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while text not in self.shown:
            assert time.monotonic() < deadline, f"{text!r} never came: {self.shown!r}"
            assert self._read(), f"it ended: {self.shown!r}"

    def type(self, line: str) -> None:
        os.write(self._ours, f"{line}\n".encode())

    def end(self) -> int:
        """Wait for its end; return the exit code."""
        while self._read():
            pass
        return self.process.wait(DEADLINE_S)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._ours)

    def _read(self) -> bool:
        if select.select([self._ours], [], [], DEADLINE_S)[0]:
            # Linux reports the end of the other side as an error.
            with suppress(OSError):
                heard = os.read(self._ours, 4096)
                self.shown += heard.decode()
                return bool(heard)
        return False


@pytest.fixture
def at_terminal() -> Generator[Callable[..., Terminal]]:
    started: list[Terminal] = []

    def start(*arguments: str) -> Terminal:
        started.append(Terminal(*arguments))
        return started[-1]

    yield start
    for each in started:
        each.close()


def put(path: Path, *names: str) -> None:
    for entry, text in STORED.items():
        if not names or entry.endswith(names):
            file_keyring.put(path, entry, text)


def one_sentence(outcome: Outcome, code: int) -> str:
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.startswith("biosensor-gateway: ")
    assert outcome.err.count("\n") == 1
    return outcome.err


@pytest.mark.seam
def test_set_asks_for_each_and_shows_none(
    store: Path, at_terminal: Callable[..., Terminal]
) -> None:
    terminal = at_terminal("set", SENSOR)
    for question, text in zip(QUESTIONS, (CLIENT_ID, CLIENT_SECRET), strict=True):
        terminal.await_text(question)
        terminal.type(text)
    assert terminal.end() == 0
    assert file_keyring.entries(store) == STORED
    assert "planted" not in terminal.shown
    assert "in the keyring" in terminal.shown


@pytest.mark.nightly
def test_set_asks_again_for_what_is_empty(
    store: Path, at_terminal: Callable[..., Terminal]
) -> None:
    terminal = at_terminal("set", SENSOR)
    terminal.await_text(QUESTIONS[0])
    terminal.shown = ""
    terminal.type("")
    terminal.await_text(QUESTIONS[0])
    terminal.type(CLIENT_ID)
    terminal.await_text(QUESTIONS[1])
    terminal.process.send_signal(signal.SIGINT)
    assert terminal.end() > 0
    assert "Traceback" not in terminal.shown
    assert "planted" not in terminal.shown
    assert list(file_keyring.entries(store).values()) == [CLIENT_ID]


@pytest.mark.nightly
@pytest.mark.usefixtures("no_keyring")
def test_set_without_a_keyring_is_one_sentence(at_terminal: Callable[..., Terminal]) -> None:
    terminal = at_terminal("set", SENSOR)
    terminal.await_text(QUESTIONS[0])
    terminal.type(CLIENT_ID)
    assert terminal.end() == 1
    *_, last = terminal.shown.split("\r\n")[:-1]
    assert last.startswith("biosensor-gateway: ")
    assert "no keyring; set EMOTIV_CLIENT_ID" in last
    assert "planted" not in terminal.shown
    assert "Traceback" not in terminal.shown


@pytest.mark.usefixtures("store")
def test_a_secret_is_never_an_argument(run: Run, store: Path) -> None:
    assert run("secrets", "set", SENSOR, CLIENT_SECRET).code == 2
    assert file_keyring.entries(store) == {}


@pytest.mark.parametrize("name", [SENSOR, "emotiv"])
def test_check_says_where_each_is_and_shows_none(
    run: Run, store: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    put(store)
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", CLIENT_SECRET)
    assert run("secrets", "check", name) == (
        0,
        (
            "The client id of the Cortex app: from the keyring\n"
            "The client secret of the Cortex app: from EMOTIV_CLIENT_SECRET\n"
        ),
        "",
    )


def test_check_names_every_one_that_is_missing(run: Run, store: Path) -> None:
    outcome = run("secrets", "check", SENSOR)
    assert (outcome.code, outcome.err) == (1, "")
    first, second = outcome.out.splitlines()
    assert "EMOTIV_CLIENT_ID" in first
    assert "EMOTIV_CLIENT_SECRET" in second
    assert f"secrets set {SENSOR}" in first
    put(store, "client_secret")
    outcome = run("secrets", "check", SENSOR)
    assert outcome.code == 1
    assert outcome.out.count("\n") == 2
    assert "client secret of the Cortex app: from the keyring" in outcome.out


def test_forget_removes_them_and_may_be_repeated(run: Run, store: Path) -> None:
    put(store)
    file_keyring.put(store, "another program/x", "kept")
    outcome = run("secrets", "forget", SENSOR)
    assert (outcome.code, outcome.out.count("removed from the keyring")) == (0, 2)
    assert list(file_keyring.entries(store).values()) == ["kept"]
    outcome = run("secrets", "forget", SENSOR)
    assert (outcome.code, outcome.out.count("was not in the keyring")) == (0, 2)


def test_forget_all_removes_those_of_every_sensor(run: Run, store: Path) -> None:
    put(store)
    file_keyring.put(store, "another program/x", "kept")
    outcome = run("secrets", "forget", "--all")
    assert (outcome.code, outcome.out.count("removed from the keyring")) == (0, 2)
    assert list(file_keyring.entries(store).values()) == ["kept"]


@pytest.mark.parametrize("arguments", [(), (SENSOR, "--all")])
def test_forget_wants_a_sensor_or_all(run: Run, store: Path, arguments: tuple[str, ...]) -> None:
    put(store)
    outcome = run("secrets", "forget", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert "name a sensor, or use --all" in outcome.err
    assert file_keyring.entries(store) == STORED


@pytest.mark.usefixtures("no_keyring")
def test_without_a_keyring_it_is_one_sentence(run: Run) -> None:
    assert "no keyring" in one_sentence(run("secrets", "forget", SENSOR), 1)
    checked = run("secrets", "check", SENSOR)
    assert (checked.code, checked.err) == (1, "")
    assert all("no keyring" in line for line in checked.out.splitlines())


@pytest.mark.usefixtures("no_keyring")
def test_the_environment_needs_no_keyring(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EMOTIV_CLIENT_ID", CLIENT_ID)
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", CLIENT_SECRET)
    outcome = run("secrets", "check", SENSOR)
    assert outcome.code == 0
    assert "planted" not in outcome.out


@pytest.mark.usefixtures("store")
@pytest.mark.parametrize("command", ["set", "forget", "check"])
def test_a_sensor_without_secrets_is_one_sentence(run: Run, command: str) -> None:
    assert "toaster" in one_sentence(run("secrets", command, "toaster"), 2)
    sentence = one_sentence(run("secrets", command, "polar_h10"), 2)
    assert "polar_h10 needs no secrets" in sentence
    assert SENSOR in sentence
