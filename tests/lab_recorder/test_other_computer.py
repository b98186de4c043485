"""LabRecorder on another computer: what can be verified there, and what cannot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.lab_recorder.conftest import Outcome
from tests.rigs.hosts.lan import Host, Lan
from tests.rigs.hosts.programs import Program

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

PORT = "22345"
LAB_PC, AGENT_PC = "lab-pc", "agent-pc"
LAB_PC_ADDRESS = "10.77.0.2"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Isolated by the namespaces; discovery is LSL's own multicast."""
    config = tmp_path / "lsl_api.cfg"
    config.write_text("[log]\nlevel = -2\n")
    return os.environ | {
        "LSLAPICFG": str(config),
        "BIOSENSOR_GATEWAY_STATE": str(tmp_path / "state"),
        "BIOSENSOR_GATEWAY_SETTINGS": str(tmp_path / "none.toml"),
    }


@pytest.fixture
def agent_pc(tmp_path: Path, environment: dict[str, str]) -> Generator[Host]:
    """The agent's computer; LabRecorder runs on another one in its network."""
    (tmp_path / "state").mkdir()
    with Lan({AGENT_PC: 0, LAB_PC: 0}) as lan:
        agent_pc, lab_pc = lan[AGENT_PC], lan[LAB_PC]
        agent = ("biosensor_gateway.cli", "run", "--simulate", "zephyr")
        recorder = ("tests.lab_recorder.peer_program", str(tmp_path), PORT)
        with (
            Program(agent_pc, environment, tmp_path, *agent),
            Program(lab_pc, environment, tmp_path, *recorder),
        ):
            yield agent_pc


def command(host: Host, environment: dict[str, str], *arguments: str) -> Outcome:
    line = host.command(sys.executable, "-m", "biosensor_gateway.cli", *arguments)
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)


def test_without_a_shared_folder_nothing_is_verified_and_that_is_said(
    agent_pc: Host, environment: dict[str, str], tmp_path: Path
) -> None:
    def record(name: str, *options: str) -> Outcome:
        where = ("--host", LAB_PC_ADDRESS, "--port", PORT)
        return command(agent_pc, environment, "record", name, *where, *options)

    ready = command(agent_pc, environment, "wait-ready", "--timeout", "60")
    assert ready.code == 0, ready.err

    blind = record("start", "--file", "blind.xdf")
    assert blind.code == 0, blind.err
    assert "not verified" in blind.out
    assert "another computer" in blind.err
    known = json.loads(record("status", "--json").out)
    assert (known["is_local"], known["recording"], known["file"]) == (False, None, None)
    ended = record("stop")
    assert (ended.code, "not verified" in ended.out) == (0, True)
    # It did all the same, only nobody could have known.
    assert (tmp_path / "blind.xdf").stat().st_size

    # The computers of these tests share their disks.
    shared = record("start", "--folder", str(tmp_path), "--participant", "p01", "--json")
    assert shared.code == 0, shared.err
    assert json.loads(shared.out)["verified"] is True
    ended = record("stop", "--json")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["verified"] is True
