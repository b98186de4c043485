"""The bench of the fault matrix, and its table at the end of the report."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from biosensor_gateway.devices.registry import declaration
from tests.faults.agent import AgentProcess
from tests.faults.bench import FaultBench
from tests.faults.expectations import SENSORS, numeric_streams, source
from tests.faults.recorder import Recorder
from tests.faults.table import LEGEND, NAME, FaultTable
from tests.rigs.lab_client import LabProcess, settings_toml
from tests.rigs.processes import before_others

JITTER_S = 0.01

_TABLE = pytest.StashKey[FaultTable]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_TABLE] = FaultTable()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send what a worker has to the process that prints, where there are workers."""
    output: dict[str, Any] | None = getattr(session.config, "workeroutput", None)
    if output is not None:
        output[NAME] = session.config.stash[_TABLE].rows()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """Take what a worker of pytest-xdist has sent; one that crashed has sent nothing."""
    del error
    node.config.stash[_TABLE].take(getattr(node, "workeroutput", {}).get(NAME, []))


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, exitstatus: int, config: pytest.Config
) -> None:
    del exitstatus
    table = config.stash.get(_TABLE, None)
    if table:
        folder = config.rootpath / "build"
        table.write(folder)
        terminalreporter.section("time to recover [s]")
        terminalreporter.write_line(table.markdown())
        terminalreporter.write_line(f"{LEGEND} All figures: {folder / NAME}.json")


def _asked_for(session: pytest.Session) -> list[str]:
    """Sensors of the tests that are run: with ``-k zephyr`` it is one, and soon done."""
    names: set[object] = set()
    for item in session.items:
        if isinstance(item, pytest.Function) and hasattr(item, "callspec"):
            names.add(item.callspec.params.get("name"))
    return [name for name in SENSORS if name in names]


@pytest.fixture(scope="module")
def bench(
    tmp_path_factory: pytest.TempPathFactory,
    pytestconfig: pytest.Config,
    request: pytest.FixtureRequest,
) -> Generator[FaultBench]:
    """The virtual devices, an agent that streams from all of them, and a recorder."""
    folder = tmp_path_factory.mktemp("bench")
    sensors = _asked_for(request.session)
    devices = [
        {"key": name, "sensor": name, "options": {"seed": seed, "jitter_s": JITTER_S}}
        for seed, name in enumerate(sensors)
    ]
    channels = {
        source(name, data_name): len(declaration(name).stream(data_name).channels)
        for name in sensors
        for data_name in numeric_streams(name)
    }
    with LabProcess(devices, folder) as lab:
        settings = folder / "settings.toml"
        settings.write_text(settings_toml(lab, {name: name for name in sensors}))
        options = ("--settings", str(settings))
        with (
            AgentProcess(folder, *options, environment=lab.environment) as agent,
            Recorder(channels) as recorder,
        ):
            # The faults are the devices'; the computer has none.
            before_others(agent.pid)
            running = FaultBench(lab, agent, recorder, pytestconfig.stash[_TABLE])
            running.wait_for_streams()
            yield running
