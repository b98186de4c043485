"""A planted secret shows in no log, no error, no status, no process list and no crash."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import structlog
from rich.console import Console
from rich.traceback import Traceback

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.emotiv_insight.driver import DRIVER
from biosensor_gateway.devices.emotiv_insight.driver import cortex as cortex_client
from biosensor_gateway.devices.emotiv_insight.driver.cortex import request_text
from biosensor_gateway.devices.emotiv_insight.simulator import App, Circumstances, Timing
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.logs import LOG_FILE_NAME, configure_logs, flush_logs
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs import file_keyring
from tests.rigs.polling import eventually, wait_until

pytestmark = pytest.mark.nightly

CLIENT_ID, CLIENT_SECRET = "planted-id-3c80f1", "planted-secret-77ab02"
WRONG_SECRET = "planted-wrong-5e19d4"
# Tokens of the virtual Cortex.
TOKEN = re.compile(r"[0-9a-f]{24}\.[0-9a-f]{24}")
QUICK = Timing(found_s=0.05, scan_s=0.3, connect_s=0.05)


@pytest.fixture
def cortex() -> Iterator[SteeredCortex]:
    with (
        World() as world,
        SteeredCortex(
            world, Circumstances(app=App(CLIENT_ID, CLIENT_SECRET)), timing=QUICK, seed=1
        ) as service,
    ):
        yield service


def leaks(text: str) -> list[str]:
    """What of the planted shows in a text."""
    found = [planted for planted in (CLIENT_ID, CLIENT_SECRET, WRONG_SECRET) if planted in text]
    return found + TOKEN.findall(text)


class Gateway:
    """An agent as a process, and all that it leaves behind."""

    def __init__(self, folder: Path, cortex: SteeredCortex, environment: dict[str, str]) -> None:
        self._folder = folder
        self._environment = {
            **{name: text for name, text in os.environ.items() if not name.startswith("EMOTIV_")},
            **environment,
            "BIOSENSOR_GATEWAY_STATE": str(folder),
            "PYTHONFAULTHANDLER": "1",
        }
        settings = folder / "settings.toml"
        fields = {"sensor": "emotiv_insight", "unit": "U1", **cortex.settings}
        lines = [f"{name} = {json.dumps(value)}" for name, value in fields.items()]
        settings.write_text("\n".join(["[[device]]", *lines]))
        with (folder / "console.txt").open("wb") as console:
            self.process = subprocess.Popen(
                self._command("run", "--verbose", "--settings", str(settings)),
                env=self._environment,
                stdout=console,
                stderr=subprocess.STDOUT,
            )

    @staticmethod
    def _command(*arguments: str) -> list[str]:
        return [sys.executable, "-m", "biosensor_gateway.cli", *arguments]

    def device(self) -> dict[str, Any]:
        """Its entry in the status file."""
        try:
            return json.loads((self._folder / "status.json").read_text())["devices"][0]
        except FileNotFoundError:
            return {"state": "", "connections": 0, "error": None}

    def has_connected(self, times: int) -> bool:
        device = self.device()
        return device["state"] == "streaming" and device["connections"] == times

    @property
    def console(self) -> str:
        return (self._folder / "console.txt").read_text()

    @property
    def log(self) -> str:
        files = sorted(self._folder.glob(f"{LOG_FILE_NAME}*"))
        assert files
        return "".join(file.read_text() for file in files)

    def ask(self, *arguments: str) -> str:
        """Run another command beside it."""
        done = subprocess.run(
            self._command(*arguments),
            env=self._environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout + done.stderr

    def abort(self) -> None:
        """Have it print what it was doing, and end."""
        self.process.send_signal(signal.SIGABRT)
        self.process.wait(30)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def start(tmp_path: Path, cortex: SteeredCortex) -> Generator[Callable[..., Gateway]]:
    started: list[Gateway] = []

    def begin(environment: dict[str, str]) -> Gateway:
        started.append(Gateway(tmp_path, cortex, environment))
        return started[-1]

    yield begin
    for each in started:
        each.end()


def process_list() -> str:
    """Command lines of all processes."""
    shown: list[str] = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            shown.append(entry.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue
    return "\n".join(shown)


def quote(cortex: SteeredCortex) -> None:
    """Have Cortex say what it was told, as no service should."""
    told = f"{CLIENT_ID} has the secret {CLIENT_SECRET}"
    cortex.send_raw(json.dumps({"jsonrpc": "2.0", "warning": {"code": 4711, "message": told}}))
    cortex.send_raw(f"no JSON: {told}")
    cortex.send_raw(json.dumps({"jsonrpc": "2.0", "id": 99999, "result": told}))


@pytest.mark.skipif(sys.platform != "linux", reason="the process list is read from /proc")
@pytest.mark.parametrize("origin", ["environment", "keyring"])
def test_an_agent_shows_no_secret_whatever_happens(
    cortex: SteeredCortex,
    start: Callable[..., Gateway],
    tmp_path: Path,
    origin: str,
) -> None:
    environment = dict(cortex.environment)
    if origin == "keyring":
        path = tmp_path / "keyring.json"
        environment = file_keyring.environment(path)
        for name, text in (("client_id", CLIENT_ID), ("client_secret", CLIENT_SECRET)):
            file_keyring.put(path, f"biosensor-gateway/emotiv_insight.{name}", text)
    agent = start(environment)
    wait_until(lambda: agent.has_connected(1))
    quote(cortex)
    wait_until(lambda: "4711" in agent.log)
    cortex.expire_token()
    cortex.close_connections(1001)
    wait_until(lambda: agent.has_connected(2))
    cortex.apply(Fault(FaultKind.RESTART, 0.5))
    wait_until(lambda: agent.has_connected(3))
    assert cortex.calls.count("authorize") >= 2
    status = agent.ask("status", "--json") + agent.ask("status")
    assert '"streaming"' in status
    said = agent.ask("secrets", "check", "emotiv_insight")
    assert "client secret" in said
    listed = process_list()
    assert "biosensor_gateway.cli run" in listed
    agent.abort()
    assert "Fatal Python error: Aborted" in agent.console
    assert "*** has the secret ***" in agent.log
    assert leaks("\n".join([agent.console, agent.log, status, said, listed])) == []


def test_rejected_secrets_are_not_quoted(
    cortex: SteeredCortex, start: Callable[..., Gateway]
) -> None:
    agent = start({"EMOTIV_CLIENT_ID": CLIENT_ID, "EMOTIV_CLIENT_SECRET": WRONG_SECRET})
    wait_until(lambda: agent.device()["error"] is not None)
    status = agent.ask("status", "--json") + agent.ask("status")
    assert "check the client id and secret" in status
    agent.abort()
    assert "check the client id and secret" in agent.console
    assert "check the client id and secret" in agent.log
    assert leaks("\n".join([agent.console, agent.log, status])) == []


def with_variables(error: BaseException) -> str:
    """A traceback with the variables of every frame, by everybody who may print one."""
    trace = structlog.tracebacks.extract(
        type(error), error, error.__traceback__, show_locals=True, locals_max_string=10_000
    )
    console = Console(width=4000, record=True, quiet=True)
    console.print(
        Traceback.from_exception(
            type(error), error, error.__traceback__, show_locals=True, locals_max_string=10_000
        )
    )
    plain = traceback.TracebackException.from_exception(error, capture_locals=True)
    return "\n".join([str(trace), console.export_text(), *plain.format()])


@pytest.mark.parametrize("broken", ["hasAccessRight", "authorize", "createSession", "subscribe"])
async def test_a_crash_shows_no_secret(
    cortex: SteeredCortex,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    logging_as_before: None,
    broken: str,
) -> None:
    """Something unexpected goes wrong with a request that a secret is in."""
    del logging_as_before
    errors: list[Exception] = []

    def break_down(request_id: int, method: str, params: Mapping[str, object] | None) -> str:
        if method != broken:
            return request_text(request_id, method, params)
        errors.append(RuntimeError("nobody expects this"))
        raise errors[-1]

    for variable, text in cortex.environment.items():
        monkeypatch.setenv(variable, text)
    monkeypatch.setattr(cortex_client, "request_text", break_down)
    configure_logs(LogSettings(), tmp_path, verbose=True)
    fields = {"sensor": "emotiv_insight", "unit": "U1", **cortex.settings}
    sink = DeviceSink(DeviceIdentity("emotiv_insight", "U1"), declaration("emotiv_insight"))
    make = DRIVER.make(DRIVER.settings.model_validate(fields), sink)
    task = asyncio.create_task(Supervisor(make, sink).run())
    log = tmp_path / LOG_FILE_NAME
    await eventually(lambda: "nobody expects this" in log.read_text())
    task.cancel()
    await asyncio.wait({task})
    assert flush_logs(30.0)
    captured = capsys.readouterr()
    assert "nobody expects this" in captured.err
    assert leaks("\n".join([log.read_text(), captured.out, captured.err])) == []
    crash = with_variables(errors[0])
    assert "Secret(***)" in crash
    assert leaks(crash) == []
