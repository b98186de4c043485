"""No resolver of the product finds a stream of another LSL session."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contracts.two_sessions import CASES, WITHOUT_BRACKETS

ROOT = Path(__file__).parents[2]
OURS, OTHERS = "group-a", "group-b"
LIMIT_S = 120.0
_SESSION = re.compile(r"(?m)^SessionID = (.*)$")
MODULES = {
    "doctor/lsl_process.py",
    "lsl/network.py",
}

pytestmark = pytest.mark.seam


def _command(role: str, environment: dict[str, str]) -> list[str]:
    session = _SESSION.findall(Path(environment["LSLAPICFG"]).read_text("utf-8"))[0]
    return [sys.executable, "-m", "tests.contracts.two_sessions", role, session]


def _environment(folder: Path, session: str) -> dict[str, str]:
    """Return that of these tests, with another session."""
    here = Path(os.environ["LSLAPICFG"]).read_text("utf-8")
    config = folder / f"{session}.cfg"
    config.write_text(_SESSION.sub(rf"SessionID = \1-{session}", here), "utf-8")
    return {**os.environ, "LSLAPICFG": str(config)}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    folder = tmp_path_factory.mktemp("sessions")
    ours, of_others = _environment(folder, OURS), _environment(folder, OTHERS)
    with subprocess.Popen(
        _command("streams", of_others),
        env=of_others,
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as others:
        assert others.stdin is not None and others.stdout is not None
        try:
            assert others.stdout.readline()
            done = subprocess.run(
                _command("resolvers", ours),
                env=ours,
                cwd=ROOT,
                stdout=subprocess.PIPE,
                check=True,
                timeout=LIMIT_S,
            )
        finally:
            others.kill()
    return {case: [each[-len(OURS) :] for each in json.loads(done.stdout)[case]] for case in CASES}


def test_each_module_that_resolves_has_its_case() -> None:
    resolving = re.compile(r"\b(ContinuousResolver|resolve_(by\w+|streams?))\(")
    modules = {
        f"{path.parent.name}/{path.name}"
        for folder in ("common", "gateway_win", "ros_side")
        for path in (ROOT / folder).rglob("*.py")
        if "pylsl" in (text := path.read_text("utf-8")) and resolving.search(text)
    }
    assert modules == MODULES


def test_without_brackets_streams_of_both_sessions_are_found(found: dict[str, list[str]]) -> None:
    assert found[WITHOUT_BRACKETS] == [OURS, OTHERS]


@pytest.mark.parametrize("case", [case for case in CASES if case != WITHOUT_BRACKETS])
def test_streams_of_the_own_session_are_found_alone(case: str, found: dict[str, list[str]]) -> None:
    assert found[case] == [OURS]
