"""The commands that try the wheel on other systems: they are run there by the workflow alone."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any, cast

import pytest
from ruamel.yaml import YAML

from tests.wheel.conftest import ROOT, Installed, users

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]

WORKFLOW = ROOT / ".github" / "workflows" / "unit.yml"


def _installed() -> dict[str, Any]:
    loaded = YAML(typ="safe", pure=True).load(WORKFLOW)  # pyright: ignore[reportUnknownMemberType]
    return cast("dict[str, Any]", loaded)["jobs"]["installed"]


def test_they_see_no_checkout_and_are_run_on_each_system() -> None:
    job = _installed()
    assert [each for each in job["steps"] if "checkout" in each.get("uses", "")] == []
    systems = {each.partition("-")[0] for each in job["strategy"]["matrix"]["system"]}
    assert systems == {"ubuntu", "windows", "macos"}


def test_they_do_what_they_are_to_do(tmp_path: Path, wheel: Path) -> None:
    installed = Installed(tmp_path, wheel)
    (step,) = (each for each in _installed()["steps"] if "xdf export" in each.get("run", ""))
    variables = users(installed.home)
    programs = tmp_path / "env" / "bin"
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=tmp_path,
        env={**variables, "PATH": f"{programs}:{variables['PATH']}"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert {each.name for each in tmp_path.glob("study_*")} >= {"study_bids", "study_csv"}
