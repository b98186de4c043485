"""The container of ``.devcontainer``, in which somebody works on this repository: ``make test``."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.containers.conftest import BASE, CERTIFICATES, ROOT, Engine, needs

MISSING = needs()

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(bool(MISSING), reason=f"NOT RUN: {MISSING}"),
]

FOLDER = ROOT / ".devcontainer"
LIMIT_S = 3300.0


def settings() -> dict[str, Any]:
    """Return what an editor reads, where a line may be a comment."""
    text = (FOLDER / "devcontainer.json").read_text(encoding="utf-8")
    return json.loads(re.sub(r"(?m)^\s*//.*$", "", text))


def test_the_unit_tests_pass_in_it_without_root(engine: Engine, tmp_path: Path) -> None:
    told = settings()
    engine.run(
        *("build", "--tag", "biosensor-gateway-dev", "--build-arg", f"BASE={BASE}"),
        *("--volume", f"{CERTIFICATES}:{CERTIFICATES}:ro"),
        *("--file", FOLDER / told["build"]["dockerfile"], FOLDER),
    )
    container = engine.run("from", "biosensor-gateway-dev").split()[-1]
    clone = tmp_path / "repository"
    subprocess.run(["git", "clone", "--quiet", "--no-local", ROOT, clone], check=True)
    there = f"/home/{told['remoteUser']}/repository"
    engine.run("copy", "--chown", "1000:1000", container, clone, there)
    engine.run("copy", container, CERTIFICATES, CERTIFICATES)
    # Where a name does not say, pip is told of the system's certificates.
    variables = {name: os.environ[name] for name in ("PIP_CERT",) if name in os.environ}
    prepare = told["postCreateCommand"]
    commands = f"cd {there} && id -un && {prepare} && make test"
    process = engine.start(container, "sh", "-c", commands, variables=variables)
    said, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, said[-8000:]
    assert said.startswith(f"{told['remoteUser']}\n")
    assert re.search(r"\d+ passed", said), said[-8000:]
