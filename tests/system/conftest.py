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

from collections.abc import Callable, Generator
from pathlib import Path

import pytest

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
    try:
        return Toolchain.install(tmp_path_factory.mktemp("toolchain") / "venv")
    except BuildToolMissingError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None


@pytest.fixture(scope="session")
def workspace(toolchain: Toolchain, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """All ROS packages of this repository, built by a plain ``colcon build``."""
    return Workspace.build(tmp_path_factory.mktemp("workspace"), toolchain)


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
