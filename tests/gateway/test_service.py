"""The unit that `service install` writes, read by systemd itself."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_gateway.cli import service

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="systemd is on Linux")
ODD = 'a b/$HOME/100%/"x"\\y.toml'


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "config"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder))
    # As where nobody is logged in.
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    monkeypatch.delenv("DBUS_SESSION_BUS_ADDRESS", raising=False)
    return folder


@pytest.mark.system
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    path = tmp_path / service.UNIT
    path.write_text(service.unit_text(["run", "--settings", ODD]))
    command = ["systemd-analyze", "verify", "--user", "--man=no", str(path)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    said = [line for line in done.stderr.splitlines() if service.UNIT in line]
    assert (done.returncode, said) == (0, []), done.stderr


def test_each_word_of_the_command_is_escaped() -> None:
    (line,) = [
        line
        for line in service.unit_text(["run", "--settings", ODD]).splitlines()
        if line.startswith("ExecStart=")
    ]
    assert line.endswith(r' "run" "--settings" "a b/$$HOME/100%%/\"x\"\\y.toml"')


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


def test_without_systemd_that_is_said(
    config: Path, run: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(config))
    outcome = run("service", "install")
    assert outcome.code == 1
    assert "no systemd here" in outcome.err
    assert not config.exists()
