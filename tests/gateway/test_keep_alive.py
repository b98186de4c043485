"""A program that dies is started again; one that ends is not."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from biosensor_gateway.system.keep_alive import restart_facts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")

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


@pytest.mark.nightly
@pytest.mark.parametrize("code", [0, 2])
def test_what_ends_as_it_should_is_not_started_again(tmp_path: Path, code: int) -> None:
    assert kept(tmp_path, str(code)) == (code, [], ["0 "])


@pytest.mark.nightly
def test_what_dies_is_started_again_at_once_and_then_after_a_while(tmp_path: Path) -> None:
    code, told, lives = kept(tmp_path, "SIGKILL", "1", "0")
    assert code == 0
    assert told == [
        "the agent has died (killed by SIGKILL) and is started again now",
        "the agent has died (exit code 1) and is started again in 1 s",
    ]
    assert lives == ["0 ", "1 killed by SIGKILL", "2 exit code 1"]


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


def test_nothing_is_said_of_a_first_life() -> None:
    assert restart_facts({}) == {}
    assert restart_facts({"BIOSENSOR_GATEWAY_RESTARTS": "0"}) == {}
    assert restart_facts({"BIOSENSOR_GATEWAY_RESTARTS": "many"}) == {}
