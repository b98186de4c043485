"""A standby takes the place of a program that has died, and ends when nobody needs it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import lives
from biosensor_gateway.system.restart_notice import RESTARTING_FILE

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")

DEADLINE_S = 30.0
PROGRAM = Path(__file__).with_name("kept_program.py")
# The second argument is Python that runs first.
SUPERVISOR = """
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

Until = Callable[[Callable[[], bool]], None]
Process = subprocess.Popen[bytes]


class Kept:
    """A supervisor, and what its program has recorded."""

    def __init__(self, folder: Path, until: Until) -> None:
        self._record, self._until = folder / "record.txt", until
        self._folder = folder
        self._supervisors: list[Process] = []

    def start(self, standby_after_s: float = 0.1, before: str = "") -> Process:
        options = [str(self._folder), before, str(standby_after_s)]
        program = [sys.executable, str(PROGRAM), str(self._record)]
        command = [sys.executable, "-c", SUPERVISOR, *options, *program]
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
        self._until(lambda: len(self.story(beginning)) >= count)
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
def kept(tmp_path: Path, until: Until) -> Generator[Kept]:
    made = Kept(tmp_path, until)
    yield made
    made.close()


@pytest.mark.seam
def test_the_standby_takes_over_and_has_a_standby_then(kept: Kept) -> None:
    supervisor = kept.start()
    standby = kept.wait_for("stands by", 1)
    first = kept.wait_for("runs", 1)
    assert first.split()[1:] == ["0"]
    kill(int(first.split()[0]))
    assert kept.wait_for("runs", 2) == f"{standby} 1 killed by SIGKILL"
    another = int(kept.wait_for("stands by", 2))
    kept.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0
    assert kept.told == ["the agent has died (killed by SIGKILL) and is started again now"]
    assert not lives(another)


@pytest.mark.nightly
def test_for_a_standby_that_has_died_a_new_program_is_started(kept: Kept, until: Until) -> None:
    kept.start()
    standby = kept.wait_for("stands by", 1)
    first = kept.wait_for("runs", 1)
    kill(int(standby))
    until(lambda: not lives(int(standby)))
    kill(int(first.split()[0]))
    again = kept.wait_for("runs", 2)
    assert again.split(maxsplit=1)[1] == "1 killed by SIGKILL"
    assert kept.story("stands by")[:1] == [standby]
    assert again.split()[0] != standby


@pytest.mark.nightly
def test_a_standby_that_cannot_be_started_keeps_nobody_from_coming_back(kept: Kept) -> None:
    supervisor = kept.start(before=NO_STANDBY)
    kill(int(kept.wait_for("runs", 1).split()[0]))
    kept.wait_for("runs", 2)
    kept.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0
    assert kept.story("stands by") == []


@pytest.mark.nightly
def test_a_standby_ends_with_its_keeper(kept: Kept, until: Until) -> None:
    supervisor = kept.start()
    kept.wait_for("runs", 1)
    standby = int(kept.wait_for("stands by", 1))
    supervisor.kill()
    until(lambda: not lives(standby))
    assert len(kept.story("runs")) == 1


@pytest.mark.nightly
@pytest.mark.parametrize("request_to_end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_ends_the_standby_as_well(
    kept: Kept, request_to_end: signal.Signals
) -> None:
    supervisor = kept.start()
    kept.wait_for("runs", 1)
    standby = int(kept.wait_for("stands by", 1))
    supervisor.send_signal(request_to_end)
    supervisor.wait(DEADLINE_S)
    assert not lives(standby)
    assert len(kept.story("runs")) == 1


@pytest.mark.nightly
def test_who_dies_soon_has_no_standby(kept: Kept) -> None:
    kept.tell_program("fail")
    supervisor = kept.start(standby_after_s=60.0)
    kept.wait_for("runs", 3)
    supervisor.send_signal(signal.SIGTERM)
    supervisor.wait(DEADLINE_S)
    assert kept.story("stands by") == []
    whens = [line.partition(" again ")[2] for line in kept.told]
    assert whens[:2] == ["now", "in 1 s"]


@pytest.fixture
def waiting(kept: Kept, state: Path, until: Until) -> Process:
    """A supervisor that waits for a minute before its next start."""
    state.mkdir()
    kept.tell_program("fail")
    supervisor = kept.start(before=f"{WAITS_FOR_A_MINUTE}; folder = {str(state)!r}")
    until(lambda: restart_notice.read(state) is not None)
    return supervisor


@pytest.mark.nightly
def test_status_says_when_it_is_started_again(
    waiting: Process, run: Callable[..., Outcome]
) -> None:
    for command in ("status", "clocks"):
        outcome = run(command)
        assert (outcome.code, outcome.out) == (1, "")
        assert "it has died (exit code 1) and is started again in " in outcome.err
        assert outcome.err.count("\n") == 1
    assert waiting.poll() is None


@pytest.mark.nightly
def test_stop_ends_who_waits(
    waiting: Process, kept: Kept, run: Callable[..., Outcome], state: Path
) -> None:
    outcome = run("stop", "--timeout", "30")
    assert outcome.code == 0
    assert outcome.out == "the agent had died, and is not started again\n"
    # It had ended when `stop` did.
    assert not lives(waiting.pid)
    assert waiting.wait() == 0
    assert list(state.iterdir()) == []
    assert len(kept.story("runs")) == 1


@pytest.mark.nightly
def test_who_is_not_stopped_goes_on_and_says_no_more(
    kept: Kept, tmp_path: Path, until: Until
) -> None:
    kept.tell_program("fail")
    supervisor = kept.start()
    until((tmp_path / RESTARTING_FILE).exists)
    (tmp_path / "record.fail").unlink()
    kept.wait_for("runs", 3)
    until(lambda: not (tmp_path / RESTARTING_FILE).exists())
    kept.tell_program("end")
    assert supervisor.wait(DEADLINE_S) == 0


@pytest.mark.nightly
def test_what_a_killed_supervisor_has_left_is_no_promise(
    waiting: Process, run: Callable[..., Outcome], state: Path
) -> None:
    waiting.kill()
    waiting.wait()
    assert (state / RESTARTING_FILE).exists()
    for command in ("status", "stop"):
        outcome = run(command)
        assert outcome.code == 1
        assert outcome.err.startswith("biosensor-gateway: no agent is running; start one with")


@pytest.mark.nightly
def test_where_nothing_can_be_written_it_waits_all_the_same(kept: Kept, tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    kept.tell_program("fail")
    supervisor = kept.start(before=f"folder = {str(in_the_way)!r}")
    kept.wait_for("runs", 3)
    supervisor.send_signal(signal.SIGTERM)
    supervisor.wait(DEADLINE_S)


@pytest.mark.parametrize("text", ["", "[]", '{"process": 1}', '{"process": "x", "at": 0}'])
def test_a_damaged_notice_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / RESTARTING_FILE).write_text(text)
    assert restart_notice.read(tmp_path) is None
