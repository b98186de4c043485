"""``biosensor-gateway pause`` and ``resume``: real processes, real streams."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.pauses import PAUSED_FILE
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

NO_AGENT = "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"
DEADLINE_S = 30.0
# More than can wait in an inlet while the commands run.
ALL_SAMPLES = 1 << 16

OpenInlet = Callable[[str], pylsl.StreamInlet]
Until = Callable[[Callable[[], bool]], None]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]


def command(folder: Path, *arguments: str) -> tuple[int, str, str]:
    ended = subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
        env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    return ended.returncode, ended.stdout, ended.stderr


def device(folder: Path) -> dict[str, Any]:
    """Return the first device of the agent's status; empty while there is none."""
    try:
        return status_file.read_status(folder)["devices"][0]
    except ConfigError:
        return {}


def counted(folder: Path, key: str) -> int:
    return sum(counters[key] for counters in device(folder).get("streams", {}).values())


@pytest.fixture
def harness() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness() as running:
        yield running


@pytest.fixture
def run(tmp_path: Path, harness: SteeredBioHarness, unit: str) -> tuple[str, ...]:
    path = tmp_path / "settings.toml"
    text = f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{harness.port}"\n'
    path.write_text(f'{text}participant = "p01"\n')
    return "run", "--settings", str(path)


@pytest.mark.seam
def test_a_participant_withdraws_and_comes_back(
    cli_process: StartCli,
    until: Until,
    inlet: OpenInlet,
    tmp_path: Path,
    run: tuple[str, ...],
    unit: str,
) -> None:
    with cli_process(tmp_path, *run) as agent:
        until(lambda: counted(tmp_path, "pushed") > 0)
        reader = inlet("p01@zephyr-ecg")
        until(lambda: bool(reader.pull_chunk(timeout=0.0)[1]))
        assert command(tmp_path, "pause", "zephyr") == (
            0,
            (
                f"zephyr/{unit} is paused: nothing of it is sent until: "
                f"biosensor-gateway resume zephyr/{unit}\n"
            ),
            "",
        )
        answered_s = pylsl.local_clock()
        until(lambda: device(tmp_path)["paused"])
        assert device(tmp_path)["state"] == "streaming"
        shown = command(tmp_path, "status")[1]
        assert f"p01 zephyr ({unit}): paused (streaming)" in " ".join(shown.split())
        withheld = counted(tmp_path, "withheld")
        until(lambda: counted(tmp_path, "withheld") > withheld + 500)
        before = reader.pull_chunk(timeout=0.0, max_samples=ALL_SAMPLES)[1]
        assert all(stamp < answered_s for stamp in before)
        assert command(tmp_path, "pause", "p01")[:2] == (
            0,
            (
                f"zephyr/{unit} was already paused: nothing of it is sent until: "
                f"biosensor-gateway resume zephyr/{unit}\n"
            ),
        )
        sent = counted(tmp_path, "pushed")
        resumed_s = pylsl.local_clock()
        assert command(tmp_path, "resume", f"zephyr/{unit}") == (
            0,
            f"zephyr/{unit} is sent again\n",
            "",
        )
        stamps: list[float] = []
        until(lambda: bool(stamps.extend(reader.pull_chunk(timeout=0.0)[1]) or stamps))
        assert stamps[0] > resumed_s
        until(lambda: counted(tmp_path, "pushed") > sent)
        assert not device(tmp_path)["paused"]
        assert device(tmp_path)["connections"] == 1
        assert counted(tmp_path, "lost") == 0
        assert command(tmp_path, "resume", "p01")[:2] == (0, f"zephyr/{unit} was not paused\n")
        assert not (tmp_path / PAUSED_FILE).exists()
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_who_has_withdrawn_is_not_streamed_by_the_next_agent(
    cli_process: StartCli,
    until: Until,
    tmp_path: Path,
    run: tuple[str, ...],
    unit: str,
    end: signal.Signals,
) -> None:
    with cli_process(tmp_path, *run) as first:
        until(lambda: counted(tmp_path, "pushed") > 0)
        assert command(tmp_path, "pause", "p01")[0] == 0
        first.send_signal(end)
        first.wait()
    (tmp_path / status_file.STATUS_FILE).unlink(missing_ok=True)
    with cli_process(tmp_path, *run) as second:
        until(lambda: counted(tmp_path, "withheld") > 500)
        assert (counted(tmp_path, "pushed"), counted(tmp_path, "lost")) == (0, 0)
        said = (tmp_path / LOG_FILE_NAME).read_text()
        assert f"biosensor-gateway resume zephyr/{unit}" in said
        assert "is paused" in (tmp_path / "stderr.txt").read_text()
        assert command(tmp_path, "resume", "p01")[0] == 0
        until(lambda: counted(tmp_path, "pushed") > 0)
        second.send_signal(signal.SIGTERM)
        assert second.wait(DEADLINE_S) == 0
    with cli_process(tmp_path, *run) as third:
        until(lambda: counted(tmp_path, "pushed") > 0)
        third.send_signal(signal.SIGTERM)
        assert third.wait(DEADLINE_S) == 0


def test_names_that_are_none_or_several_are_refused_in_one_sentence(
    cli_process: StartCli, until: Until, tmp_path: Path, run: tuple[str, ...], unit: str
) -> None:
    more = '[[device]]\nsensor = "zephyr"\nunit = "other"\nport = "nowhere"\n'
    path = Path(run[-1])
    path.write_text(path.read_text() + more)
    with cli_process(tmp_path, *run) as agent:
        until(lambda: counted(tmp_path, "pushed") > 0)
        assert command(tmp_path, "pause", "zephyr") == (
            1,
            "",
            (
                "biosensor-gateway: the agent refused pause: several devices are called 'zephyr'; "
                f"say which one: zephyr/{unit} (p01), zephyr/other\n"
            ),
        )
        assert command(tmp_path, "resume", "p02") == (
            1,
            "",
            (
                "biosensor-gateway: the agent refused resume: no device is called 'p02'; "
                f"there are: zephyr/{unit} (p01), zephyr/other\n"
            ),
        )
        assert not device(tmp_path)["paused"]
        # One that was never connected can be paused as well.
        assert command(tmp_path, "pause", "zephyr/other")[0] == 0
        until(lambda: status_file.read_status(tmp_path)["devices"][1]["paused"])
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


def test_without_an_agent_it_says_so(tmp_path: Path) -> None:
    for name in ("pause", "resume"):
        assert command(tmp_path / "state", name, "zephyr") == (1, "", NO_AGENT)
    assert list(tmp_path.iterdir()) == []


def test_a_pause_that_cannot_be_kept_holds_and_is_said(
    cli_process: StartCli, until: Until, tmp_path: Path, run: tuple[str, ...], unit: str
) -> None:
    with cli_process(tmp_path, *run) as agent:
        until(lambda: counted(tmp_path, "pushed") > 0)
        # A folder cannot be replaced by a file.
        (tmp_path / PAUSED_FILE).mkdir()
        code, out, err = command(tmp_path, "pause", "zephyr")
        assert (code, f"zephyr/{unit} is paused" in out) == (1, True)
        assert err.count("\n") == 1
        assert str(tmp_path / PAUSED_FILE) in err
        assert "a new start of the agent would stream it again" in err
        until(lambda: device(tmp_path)["paused"])
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


def test_if_it_cannot_be_read_who_has_withdrawn_nothing_is_streamed(
    tmp_path: Path, run: tuple[str, ...], harness: SteeredBioHarness
) -> None:
    (tmp_path / PAUSED_FILE).write_text("{")
    code, out, err = command(tmp_path, *run)
    assert (code, out) == (2, "")
    assert "it cannot be read who has withdrawn" in err
    assert "Traceback" not in err
    assert not harness.sent
