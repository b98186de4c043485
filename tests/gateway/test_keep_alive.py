"""A program, the agent too, that dies is started again; one that ends, or is left, is not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from subprocess import Popen
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil
import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import STREAMS_FILE
from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import lives
from biosensor_gateway.system.keep_alive import restart_facts
from biosensor_gateway.system.logs import LOG_FILE_NAME
from biosensor_gateway.system.restart_notice import RESTARTING_FILE
from tests.gateway.test_agent_process import command, stop
from tests.rigs.gateway import cli_process
from tests.rigs.polling import wait_until
from tests.rigs.terminal import at_terminal

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

# Ends as the next of its arguments says: a signal, or an exit code. Notes its environment.
PROGRAM = """
import os, sys
from pathlib import Path
log = Path(sys.argv[1])
lives = log.read_text().splitlines() if log.exists() else []
names = "BIOSENSOR_GATEWAY_RESTARTS", "BIOSENSOR_GATEWAY_LAST_END"
log.write_text("\\n".join([*lives, " ".join(os.environ[name] for name in names)]))
end = sys.argv[2 + len(lives)]
if end.isdecimal():
    sys.exit(int(end))
os.kill(os.getpid(), getattr(__import__("signal"), end))
"""
SUPERVISOR = """
import sys
from pathlib import Path
from biosensor_gateway.system.keep_alive import KeepAlive
tell = lambda sentence: print(sentence, flush=True)
sys.exit(KeepAlive(sys.argv[2:], tell, Path(sys.argv[1])).run())
"""
WAITS = "import time; print('waiting', flush=True); time.sleep(60)"


def kept(folder: Path, *ends: str) -> tuple[int, list[str], list[str]]:
    """Exit code, what was told, and what each life found in its environment."""
    log = folder / "log"
    command = [
        sys.executable,
        "-c",
        SUPERVISOR,
        str(folder),
        sys.executable,
        "-c",
        PROGRAM,
        str(log),
        *ends,
    ]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout.splitlines(), log.read_text().splitlines()


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
@pytest.mark.parametrize("code", [0, 2])
def test_what_ends_as_it_should_is_not_started_again(tmp_path: Path, code: int) -> None:
    assert kept(tmp_path, str(code)) == (code, [], ["0 "])


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_what_dies_is_started_again_at_once_and_then_after_a_while(tmp_path: Path) -> None:
    code, told, lives = kept(tmp_path, "SIGKILL", "1", "0")
    assert code == 0
    assert told == [
        "the agent has died (killed by SIGKILL) and is restarted now",
        "the agent has died (exit code 1) and is restarted in 1 s",
    ]
    assert lives == ["0 ", "1 killed by SIGKILL", "2 exit code 1"]


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
@pytest.mark.parametrize("request_to_end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_reaches_the_program(
    tmp_path: Path, request_to_end: signal.Signals
) -> None:
    command = [sys.executable, "-c", SUPERVISOR, str(tmp_path), sys.executable, "-c", WAITS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as supervisor:
        assert supervisor.stdout is not None
        assert supervisor.stdout.readline() == "waiting\n"
        supervisor.send_signal(request_to_end)
        supervisor.wait(60)
        assert supervisor.stdout.read() == ""


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
def test_nothing_is_said_of_a_first_life() -> None:
    assert restart_facts({}) == {}
    assert restart_facts({"BIOSENSOR_GATEWAY_RESTARTS": "0"}) == {}
    assert restart_facts({"BIOSENSOR_GATEWAY_RESTARTS": "many"}) == {}


DEADLINE_S = 30.0
ECG, ECG_STEP_S = "zephyr-virtual-ecg", 1 / 250
AFTER_S = 4.0


def status(folder: Path) -> dict[str, Any]:
    try:
        return status_file.read_status(folder)
    except ConfigError:
        return {"devices": []}


def pushed(folder: Path) -> int:
    devices = status(folder)["devices"]
    return sum(each["pushed"] for device in devices for each in device["streams"].values())


class Events:
    """The heartbeats in the agent's stream of events, over its lives."""

    def __init__(self) -> None:
        source = naming.source_id(DeviceIdentity("gateway", os.uname().nodename), "events")
        (info,) = pylsl.resolve_byprop("source_id", source, timeout=DEADLINE_S)
        self._inlet = pylsl.StreamInlet(info, recover=True)
        self._heartbeats: list[dict[str, Any]] = []

    def heartbeats(self) -> list[dict[str, Any]]:
        while (sample := self._inlet.pull_sample(0.0)[0]) is not None:
            event = json.loads(sample[0])
            if event["event"] == "heartbeat":
                self._heartbeats.append(event)
        return self._heartbeats

    def close(self) -> None:
        self._inlet.close_stream()


def standby_of(supervisor: Popen[bytes], agent: int) -> int:
    """The process that waits beside the agent; 0 while there is none."""
    others = [each.pid for each in psutil.Process(supervisor.pid).children() if each.pid != agent]
    return others[0] if others else 0


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.seam
def test_a_killed_agent_comes_back_says_so_and_ends_when_asked(tmp_path: Path) -> None:
    with cli_process(tmp_path, "run", "--keep-alive", "--simulate", "zephyr") as supervisor:
        wait_until(lambda: pushed(tmp_path) > 0 and (tmp_path / STREAMS_FILE).exists())
        killed = status(tmp_path)["process"]
        assert killed != supervisor.pid
        events = Events()
        wait_until(lambda: len(events.heartbeats()) > 0)
        first = events.heartbeats()[-1]
        assert "restarts" not in first
        wait_until(lambda: standby_of(supervisor, killed) != 0)
        standby = standby_of(supervisor, killed)
        os.kill(killed, signal.SIGKILL)
        wait_until(
            lambda: status(tmp_path).get("process", killed) != killed and pushed(tmp_path) > 0
        )
        assert status(tmp_path)["process"] == standby
        assert status(tmp_path)["restarts"] == 1
        shown = command(tmp_path, "status").stdout
        assert "started again once, last after: killed by SIGKILL" in shown
        # Recorders hear it from a heartbeat: they are not back yet when the agent starts.
        wait_until(lambda: events.heartbeats()[-1]["agent_started"] > first["agent_started"])
        second = events.heartbeats()[-1]
        assert (second["restarts"], second["last_end"]) == (1, "killed by SIGKILL")
        events.close()
        assert stop(tmp_path)[0] == 0
        assert supervisor.wait(DEADLINE_S) == 0
    said = (tmp_path / "stderr.txt").read_text()
    assert "the agent has died (killed by SIGKILL) and is restarted now" in said
    log = [json.loads(line) for line in (tmp_path / LOG_FILE_NAME).read_text().splitlines()]
    (restart,) = [each for each in log if "was restarted" in each["event"]]
    assert (restart["restarts"], restart["last_end"]) == (1, "killed by SIGKILL")
    assert not (tmp_path / STREAMS_FILE).exists()


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_a_stream_goes_on_after_one_gap(tmp_path: Path) -> None:
    with cli_process(tmp_path, "run", "--keep-alive", "--simulate", "zephyr") as supervisor:
        wait_until(lambda: pushed(tmp_path) > 0)
        killed = status(tmp_path)["process"]
        (info,) = pylsl.resolve_byprop("source_id", ECG, timeout=DEADLINE_S)
        reader = pylsl.StreamInlet(info, recover=True)
        wait_until(lambda: standby_of(supervisor, killed) != 0)
        standby = standby_of(supervisor, killed)
        stamps = received(reader)
        os.kill(killed, signal.SIGKILL)
        killed_s = pylsl.local_clock()
        while stamps[-1] < killed_s + AFTER_S:
            stamps += received(reader)
        reader.close_stream()
        assert status(tmp_path)["process"] == standby
        assert stop(tmp_path)[0] == 0
        assert supervisor.wait(DEADLINE_S) == 0
    steps = np.diff(stamps)
    assert steps.min() > 0
    (gap,) = np.flatnonzero(steps > 2 * ECG_STEP_S)
    assert stamps[gap] <= killed_s < stamps[gap + 1]


def received(reader: pylsl.StreamInlet) -> list[float]:
    stamps: list[float] = []

    def some_came() -> bool:
        stamps.extend(reader.pull_chunk(0.0, max_samples=1024)[1])
        return bool(stamps)

    wait_until(some_came)
    return stamps


RUN = [sys.executable, "-m", "biosensor_gateway.cli", "run", "--keep-alive"]
MENU = "Type a number, then Enter [1]:"


def environment(folder: Path) -> Mapping[str, str]:
    return os.environ | {
        "BIOSENSOR_GATEWAY_STATE": str(folder / "state"),
        "BIOSENSOR_GATEWAY_SETTINGS": str(folder / "settings.toml"),
        "TERM": "xterm",
    }


@pytest.mark.nightly
def test_the_end_of_input_is_no_death(tmp_path: Path) -> None:
    with at_terminal(RUN, environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        terminal.type("\x04")
        assert terminal.exit_code() == 2
    assert "started again" not in terminal.screen.text


@pytest.mark.nightly
def test_a_standby_can_ask_who_sits_there(tmp_path: Path) -> None:
    with at_terminal([*RUN, "--ask"], environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        (supervisor,) = psutil.Process().children()
        terminal.until(lambda _seen: len(supervisor.children()) == 2)
        agent, standby = sorted(supervisor.children(), key=lambda each: each.create_time())
        agent.kill()
        terminal.until(lambda seen: "is restarted now" in seen and seen.endswith(MENU))
        assert standby in supervisor.children()
        terminal.type("3\n")
        assert terminal.exit_code() == 0


@pytest.mark.nightly
def test_who_has_chosen_devices_need_not_come_back(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('[[device]]\nsensor = "zephyr"\nunit = "B1"\nport = "/dev/no-such-port"\n')
    with at_terminal([*RUN, "--ask"], environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        terminal.type("\n")
        terminal.until_seen("Zephyr BioHarness 3 B1")
        (supervisor,) = psutil.Process().children()
        terminal.until(lambda _seen: len(supervisor.children()) == 2)
        agent, _standby = sorted(supervisor.children(), key=lambda each: each.create_time())
        agent.kill()
        shown = terminal.until_seen("the agent had died and was restarted")
        assert shown.count(MENU) == 1
        terminal.type("\x03")
        assert terminal.exit_code() == 0


# A standby takes the place of a program that has died, and ends when nobody needs it.


STANDBY_PROGRAM = Path(__file__).with_name("kept_program.py")
# The second argument is Python that runs first.
STANDBY_SUPERVISOR = """
import sys
from pathlib import Path
from biosensor_gateway.system.keep_alive import KeepAlive
folder, before, standby_after_s, *command = sys.argv[1:]
exec(before)
tell = lambda sentence: print(sentence, flush=True)
sys.exit(KeepAlive(command, tell, Path(folder), float(standby_after_s)).run())
"""
NO_STANDBY = """
def no_memory(command):
    raise OSError

from biosensor_gateway.system import keep_alive
keep_alive.Standby = no_memory
"""
WAITS_FOR_A_MINUTE = "KeepAlive._delays = lambda self: iter([0.0, 60.0])"

Process = subprocess.Popen[bytes]


class Kept:
    """A supervisor, and what its program has recorded."""

    def __init__(self, folder: Path) -> None:
        self._record = folder / "record.txt"
        self._folder = folder
        self._supervisors: list[Process] = []

    def start(self, standby_after_s: float = 0.1, before: str = "") -> Process:
        options = [str(self._folder), before, str(standby_after_s)]
        program = [sys.executable, str(STANDBY_PROGRAM), str(self._record)]
        command = [sys.executable, "-c", STANDBY_SUPERVISOR, *options, *program]
        with (self._folder / "told.txt").open("wb") as told:
            supervisor = subprocess.Popen(command, stdout=told)
        self._supervisors.append(supervisor)
        return supervisor

    @property
    def told(self) -> list[str]:
        """What the supervisor said."""
        return (self._folder / "told.txt").read_text().splitlines()

    def tell_program(self, word: str) -> None:
        self._record.with_suffix(f".{word}").touch()

    def story(self, beginning: str) -> list[str]:
        lines = self._record.read_text().splitlines() if self._record.exists() else []
        return [line[len(beginning) + 1 :] for line in lines if line.startswith(f"{beginning} ")]

    def wait_for(self, beginning: str, count: int) -> str:
        """Return the last of so many lines that begin so."""
        wait_until(lambda: len(self.story(beginning)) >= count)
        return self.story(beginning)[count - 1]

    def close(self) -> None:
        for supervisor in self._supervisors:
            supervisor.kill()
            supervisor.wait()
        for line in self.story("runs"):
            kill(int(line.split()[0]))


def kill(process: int) -> None:
    if lives(process):
        psutil.Process(process).send_signal(signal.SIGKILL)


@pytest.fixture
def kept_with_standby(tmp_path: Path) -> Generator[Kept]:
    made = Kept(tmp_path)
    yield made
    made.close()


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.seam
def test_the_standby_takes_over_and_has_a_standby_then(kept_with_standby: Kept) -> None:
    supervisor = kept_with_standby.start()
    standby = kept_with_standby.wait_for("stands by", 1)
    first = kept_with_standby.wait_for("runs", 1)
    assert first.split()[1:] == ["0"]
    kill(int(first.split()[0]))
    assert kept_with_standby.wait_for("runs", 2) == f"{standby} 1 killed by SIGKILL"
    another = int(kept_with_standby.wait_for("stands by", 2))
    kept_with_standby.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0
    assert kept_with_standby.told == ["the agent has died (killed by SIGKILL) and is restarted now"]
    assert not lives(another)


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_for_a_standby_that_has_died_a_new_program_is_started(kept_with_standby: Kept) -> None:
    kept_with_standby.start()
    standby = kept_with_standby.wait_for("stands by", 1)
    first = kept_with_standby.wait_for("runs", 1)
    kill(int(standby))
    wait_until(lambda: not lives(int(standby)))
    kill(int(first.split()[0]))
    again = kept_with_standby.wait_for("runs", 2)
    assert again.split(maxsplit=1)[1] == "1 killed by SIGKILL"
    assert kept_with_standby.story("stands by")[:1] == [standby]
    assert again.split()[0] != standby


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_a_standby_that_cannot_be_started_keeps_nobody_from_coming_back(
    kept_with_standby: Kept,
) -> None:
    supervisor = kept_with_standby.start(before=NO_STANDBY)
    kill(int(kept_with_standby.wait_for("runs", 1).split()[0]))
    kept_with_standby.wait_for("runs", 2)
    kept_with_standby.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0
    assert kept_with_standby.story("stands by") == []


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_a_standby_ends_with_its_keeper(kept_with_standby: Kept) -> None:
    supervisor = kept_with_standby.start()
    kept_with_standby.wait_for("runs", 1)
    standby = int(kept_with_standby.wait_for("stands by", 1))
    supervisor.kill()
    wait_until(lambda: not lives(standby))
    assert len(kept_with_standby.story("runs")) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
@pytest.mark.parametrize("request_to_end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_ends_the_standby_as_well(
    kept_with_standby: Kept, request_to_end: signal.Signals
) -> None:
    supervisor = kept_with_standby.start()
    kept_with_standby.wait_for("runs", 1)
    standby = int(kept_with_standby.wait_for("stands by", 1))
    supervisor.send_signal(request_to_end)
    supervisor.wait(DEADLINE_S)
    assert not lives(standby)
    assert len(kept_with_standby.story("runs")) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_who_dies_soon_has_no_standby(kept_with_standby: Kept) -> None:
    kept_with_standby.tell_program("fail")
    supervisor = kept_with_standby.start(standby_after_s=60.0)
    kept_with_standby.wait_for("runs", 3)
    supervisor.send_signal(signal.SIGTERM)
    supervisor.wait(DEADLINE_S)
    assert kept_with_standby.story("stands by") == []
    whens = [line.partition(" restarted ")[2] for line in kept_with_standby.told]
    assert whens[:2] == ["now", "in 1 s"]


@pytest.fixture
def waiting(kept_with_standby: Kept, state: Path) -> Process:
    """A supervisor that waits for a minute before its next start."""
    state.mkdir()
    kept_with_standby.tell_program("fail")
    supervisor = kept_with_standby.start(before=f"{WAITS_FOR_A_MINUTE}; folder = {str(state)!r}")
    wait_until(lambda: restart_notice.read(state) is not None)
    return supervisor


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_status_says_when_it_is_started_again(
    waiting: Process, run: Callable[..., Outcome]
) -> None:
    for asked in ("status", "clocks"):
        outcome = run(asked)
        assert (outcome.code, outcome.out) == (1, "")
        assert "it has died (exit code 1) and is restarted in " in outcome.err
        assert outcome.err.count("\n") == 1
    assert waiting.poll() is None


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_stop_ends_who_waits(
    waiting: Process, kept_with_standby: Kept, run: Callable[..., Outcome], state: Path
) -> None:
    outcome = run("stop", "--timeout", "30")
    assert outcome.code == 0
    assert outcome.out == "the agent had died, and is not restarted\n"
    # It had ended when `stop` did.
    assert not lives(waiting.pid)
    assert waiting.wait() == 0
    assert list(state.iterdir()) == []
    assert len(kept_with_standby.story("runs")) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_who_is_not_stopped_goes_on_and_says_no_more(
    kept_with_standby: Kept, tmp_path: Path
) -> None:
    kept_with_standby.tell_program("fail")
    supervisor = kept_with_standby.start()
    wait_until((tmp_path / RESTARTING_FILE).exists)
    (tmp_path / "record.fail").unlink()
    kept_with_standby.wait_for("runs", 3)
    wait_until(lambda: not (tmp_path / RESTARTING_FILE).exists())
    kept_with_standby.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_what_a_killed_supervisor_has_left_is_no_promise(
    waiting: Process, run: Callable[..., Outcome], state: Path
) -> None:
    waiting.kill()
    waiting.wait()
    assert (state / RESTARTING_FILE).exists()
    for asked in ("status", "stop"):
        outcome = run(asked)
        assert outcome.code == 1
        assert outcome.err.startswith("biosensor-gateway: no agent is running; start one with")


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.nightly
def test_where_nothing_can_be_written_it_waits_all_the_same(
    kept_with_standby: Kept, tmp_path: Path
) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    kept_with_standby.tell_program("fail")
    supervisor = kept_with_standby.start(before=f"folder = {str(in_the_way)!r}")
    kept_with_standby.wait_for("runs", 3)
    supervisor.send_signal(signal.SIGTERM)
    supervisor.wait(DEADLINE_S)


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.parametrize("text", ["", "[]", '{"process": 1}', '{"process": "x", "at": 0}'])
def test_a_damaged_notice_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / RESTARTING_FILE).write_text(text)
    assert restart_notice.read(tmp_path) is None
