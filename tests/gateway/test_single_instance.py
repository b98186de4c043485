"""One agent per state folder, and the unit that `service install` writes."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.single_instance import (
    LOCK_FILE,
    is_held,
    single_instance,
    wait_until_free,
)
from biosensor_gateway.cli import service

DEADLINE_S = 30.0

HOLDER = """
import sys
from pathlib import Path
from biosensor_gateway.agent.single_instance import single_instance

with single_instance(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
"""

# Takes the lock again and again, in a greater hurry than an agent; if two of them have it at
# a time, one fails.
CONTENDER = """
import os, sys, time
from pathlib import Path
from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import single_instance as module

module._POLL_S = 0.0005
folder, wanted = Path(sys.argv[1]), int(sys.argv[2])
inside, taken = folder / "inside", 0
while taken < wanted:
    try:
        with module.single_instance(folder):
            os.close(os.open(inside, os.O_CREAT | os.O_EXCL))
            time.sleep(0.003)
            inside.unlink()
            taken += 1
    except ConfigError:
        pass
"""

ONLOOKER = """
import sys
from pathlib import Path
from biosensor_gateway.agent.single_instance import is_held

print("looking", flush=True)
while True:
    is_held(Path(sys.argv[1]))
"""


@contextmanager
def program(code: str, *arguments: str) -> Generator[subprocess.Popen[str]]:
    """Run Python in a process; it has said its first word."""
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() != ""
        yield process
        process.kill()


def refusal(folder: Path) -> ConfigError:
    with pytest.raises(ConfigError) as caught, single_instance(folder):
        pass
    return caught.value


def test_the_folder_is_made_and_nothing_is_left_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there"
    assert not is_held(folder)
    assert not folder.exists()
    with single_instance(folder):
        assert is_held(folder)
    assert not is_held(folder)
    assert list(folder.iterdir()) == []


@pytest.mark.nightly
def test_a_second_one_is_told_which_runs_and_what_to_do(tmp_path: Path) -> None:
    with program(HOLDER, str(tmp_path)) as holder:
        error = refusal(tmp_path)
        assert error.reason is ConfigReason.IN_USE
        for words in (str(tmp_path), "biosensor-gateway status", "biosensor-gateway stop"):
            assert words in str(error)
        assert is_held(tmp_path)
        assert not wait_until_free(tmp_path, 0.1)
        holder.communicate("end\n")
    with single_instance(tmp_path):
        pass


@pytest.mark.nightly
def test_each_folder_has_an_agent_of_its_own(tmp_path: Path) -> None:
    with program(HOLDER, str(tmp_path / "one")), single_instance(tmp_path / "other"):
        assert is_held(tmp_path / "one")


@pytest.mark.seam
def test_a_killed_one_blocks_nobody(tmp_path: Path) -> None:
    with program(HOLDER, str(tmp_path)) as holder:
        holder.kill()
        holder.wait()
    assert (tmp_path / LOCK_FILE).exists()
    assert not is_held(tmp_path)
    with single_instance(tmp_path):
        assert is_held(tmp_path)


@pytest.mark.nightly
def test_waiting_ends_with_the_agent(tmp_path: Path) -> None:
    with program(HOLDER, str(tmp_path)) as holder:
        assert holder.stdin is not None
        holder.stdin.write("end\n")
        holder.stdin.flush()
        assert wait_until_free(tmp_path, DEADLINE_S)


def test_the_lock_is_given_back_by_an_agent_that_fails(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), single_instance(tmp_path):
        raise RuntimeError("a mistake")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_never_two_at_a_time_though_the_file_comes_and_goes(tmp_path: Path) -> None:
    command = [sys.executable, "-c", CONTENDER, str(tmp_path), "100"]
    contenders = [subprocess.Popen(command) for _ in range(4)]
    assert [contender.wait(2 * DEADLINE_S) for contender in contenders] == [0, 0, 0, 0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_looking_whether_one_runs_keeps_none_from_starting(tmp_path: Path) -> None:
    with program(ONLOOKER, str(tmp_path)):
        for _ in range(100):
            with single_instance(tmp_path):
                pass


def test_a_folder_that_cannot_be_written_is_another_matter(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    for folder in (in_the_way, in_the_way / "below"):
        error = refusal(folder)
        assert error.reason is ConfigReason.UNREADABLE
        assert str(folder) in str(error)
        assert "stop" in str(error)
        assert not is_held(folder)


def test_a_file_system_without_locks_gets_no_lock_that_outlives_its_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(_file: int, _operation: int) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", missing)
    assert refusal(tmp_path).reason is ConfigReason.UNREADABLE
    assert not is_held(tmp_path)


if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

ODD = 'a b/$HOME/100%/"x"\\y.toml'


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "config"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder))
    # As where nobody is logged in.
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    monkeypatch.delenv("DBUS_SESSION_BUS_ADDRESS", raising=False)
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="systemd is on Linux")
@pytest.mark.system
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    path = tmp_path / service.UNIT
    path.write_text(service.unit_text(["run", "--settings", ODD]))
    command = ["systemd-analyze", "verify", "--user", "--man=no", str(path)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    said = [line for line in done.stderr.splitlines() if service.UNIT in line]
    assert (done.returncode, said) == (0, []), done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="systemd is on Linux")
def test_each_word_of_the_command_is_escaped() -> None:
    (line,) = [
        line
        for line in service.unit_text(["run", "--settings", ODD]).splitlines()
        if line.startswith("ExecStart=")
    ]
    assert line.endswith(r' "run" "--settings" "a b/$$HOME/100%%/\"x\"\\y.toml"')


@pytest.mark.skipif(sys.platform != "linux", reason="systemd is on Linux")
@pytest.mark.nightly
def test_without_a_manager_the_unit_is_there_and_one_sentence_says_what_to_do(
    config: Path, run: Callable[..., Outcome]
) -> None:
    if shutil.which("systemctl") is None:
        pytest.skip("no systemctl on this computer")
    outcome = run("service", "install", "--settings", "my.toml")
    unit = config / "systemd" / "user" / service.UNIT
    assert outcome.code == 1
    assert outcome.err.count("\n") == 1
    assert str(unit) in outcome.err
    assert f"systemctl --user enable --now {service.UNIT}" in outcome.err
    assert f'"--settings" "{Path("my.toml").resolve()}"' in unit.read_text()
    outcome = run("service", "remove")
    assert outcome.err.count("\n") == 1
    assert not unit.exists()
    outcome = run("service", "remove")
    assert (outcome.code, outcome.out) == (0, "there is no service\n")


@pytest.mark.skipif(sys.platform != "linux", reason="systemd is on Linux")
def test_without_systemd_that_is_said(
    config: Path, run: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(config))
    outcome = run("service", "install")
    assert outcome.code == 1
    assert "no systemd here" in outcome.err
    assert not config.exists()
