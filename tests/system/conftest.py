"""A built ROS workspace for all system tests that ask for one.

It is made once in a run, by the first test that needs it, in about half a minute. A test
that runs the installed node, and reads a topic whose messages colcon has built::

    environment = workspace.environment()
    node = start("node", [workspace.node], env=environment)
    listen = workspace.program("tests.system.subscriber", "biosensor_msgs/msg/Samples", topic)
    subscriber = start("subscriber", listen, env=environment)
    ...
    assert subscriber.records, node.output
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from filelock import FileLock

from tests.system.programs import Program
from tests.system.toolchain import BUILD_TIMEOUT_S, BuildToolMissingError, Toolchain
from tests.system.workspace import Workspace


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        builds = isinstance(item, pytest.Function) and "toolchain" in item.fixturenames
        if builds and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(BUILD_TIMEOUT_S))


@pytest.fixture(scope="session")
def toolchain(tmp_path_factory: pytest.TempPathFactory) -> Toolchain:
    """ROS and colcon from the locks, without this project."""
    place = _shared(tmp_path_factory) / "toolchain"
    try:
        _make_once(place, lambda: Toolchain.install(place / "venv"))
    except BuildToolMissingError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    return Toolchain(place / "venv")


@pytest.fixture(scope="session")
def workspace(toolchain: Toolchain, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """All ROS packages of this repository, built by a plain ``colcon build``."""
    place = _shared(tmp_path_factory) / "workspace"
    _make_once(place, lambda: Workspace.build(place / "repository", toolchain))
    return Workspace(place / "repository", toolchain, linked=False)


def _shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of this run, which the workers of pytest-xdist have in common."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


def _make_once(place: Path, make: Callable[[], object]) -> None:
    """Let the first worker that needs something make it, and the others wait."""
    made = place / "made"
    with FileLock(f"{place}.lock"):
        if not made.exists():
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            make()
            made.touch()


@pytest.fixture
def start(tmp_path: Path) -> Generator[Callable[..., Program]]:
    """Start ``start(name, command, **options)``; it ends with the test."""
    programs: list[Program] = []

    def start(name: str, command: list[str], **options: object) -> Program:
        programs.append(Program(command, tmp_path / f"{name}.log", **options))
        return programs[-1]

    yield start
    for program in programs:
        program.end()
