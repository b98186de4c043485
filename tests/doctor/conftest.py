"""What the tests of doctor share: settings, checks that are run, outlets, a program."""

from __future__ import annotations

import json
import os
import sys
import uuid
from collections.abc import Callable, Generator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from typer.testing import CliRunner

from biosensor_common.doctor.check import AGENT, Finding, Level, checks_of
from biosensor_common.doctor.probe import PROBE_COMMAND
from biosensor_common.doctor.report import run_checks
from biosensor_gateway.cli import doctor as commands
from biosensor_gateway.doctor.context import Context, read_context
from tests.doctor.outlets import Offered, arguments, running
from tests.rigs.kept_logging import kept_logging

Examine = Callable[[Context, str], list[Finding]]
"""Runs one check of the table; returns what it found."""

ZEPHYR = '[[device]]\nsensor = "zephyr"\nunit = "1"\nport = "{}"\n'
POLAR = '[[device]]\nsensor = "polar_h10"\nunit = "1"\n'
E4 = '[[device]]\nsensor = "empatica_e4"\nunit = "1"\nhost = "127.0.0.1"\nport = {}\n'


@pytest.fixture
def configured(tmp_path: Path) -> Callable[[str], Context]:
    """Write settings and read them."""

    def write(text: str) -> Context:
        path = tmp_path / "settings.toml"
        path.write_text(text)
        return read_context(path, tmp_path / "state")

    return write


@pytest.fixture
def context(configured: Callable[[str], Context]) -> Context:
    """Settings without a device."""
    return configured("")


@pytest.fixture(scope="session")
def examine() -> Examine:
    def run(context: Context, name: str) -> list[Finding]:
        report = run_checks([each for each in checks_of(AGENT) if each.name == name], context)
        for finding in report.findings:
            assert finding.check == name
            assert not finding.what.startswith("the check"), finding.what
        return list(report.findings)

    return run


@pytest.fixture
def lsl_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Write an lsl_api.cfg, which LSL programs read from then on."""

    def write(text: str) -> Path:
        path = tmp_path / "lsl_api.cfg"
        path.write_text(text)
        monkeypatch.setenv("LSLAPICFG", str(path))
        return path

    return write


@pytest.fixture
def session(lsl_file: Callable[[str], Path]) -> str:
    """An LSL session with nobody in it."""
    name = f"doctor-{uuid.uuid4().hex}"
    lsl_file(f"[lab]\nSessionID = {name}\n[multicast]\nResolveScope = machine\n")
    return name


class Outcome(NamedTuple):
    code: int
    out: str

    @property
    def json(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.out)
        return content


def program() -> typer.Typer:
    """The two commands as the program has them."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(commands.doctor)
    app.command(PROBE_COMMAND, hidden=True)(commands.doctor_probe)
    return app


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Callable[..., Outcome]]:
    """Run the command in this process; no settings file is there by default."""
    monkeypatch.setenv("BIOSENSOR_GATEWAY_SETTINGS", str(tmp_path / "settings.toml"))
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path / "state"))

    def command(*arguments: str) -> Outcome:
        result = CliRunner().invoke(program(), ["doctor", *arguments])
        assert result.exception is None or isinstance(result.exception, SystemExit)
        return Outcome(result.exit_code, result.output)

    with kept_logging():
        yield command


@pytest.fixture
def offer(session: str) -> Generator[Callable[..., None]]:
    """Have outlets in the session, in another process, until the test ends."""
    with ExitStack() as stack:

        def start(*streams: Offered) -> None:
            command = [sys.executable, *arguments(session, streams)]
            stack.enter_context(running(command, os.environ))

        yield start


def above_ok(findings: list[Finding]) -> list[Finding]:
    return [each for each in findings if each.level is not Level.OK]


def only(findings: list[Finding], part: str) -> Finding:
    """The one finding that says this."""
    (found,) = [each for each in findings if part in each.what]
    return found
