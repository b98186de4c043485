"""`colcon build` of this repository, and the node that it installs.

The build has an environment of its own, in which this project is not installed: what
runs is what colcon has built. Nothing is skipped: without git, bash, a compiler, the
locks or a package index these tests fail, because they run only where they are asked for.
"""

from __future__ import annotations

import json
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float32MultiArray

from tests.system.programs import Program
from tests.system.toolchain import (
    BUILD_TIMEOUT_S,
    Toolchain,
)
from tests.system.workspace import Workspace, copy_repository

pytestmark = pytest.mark.system

DEADLINE_S = 30.0
SAMPLES = 50
# Each package, and where the links of a symlinked build lead; messages are generated.
PACKAGES = {
    "biosensor_common": "common",
    "biosensor_msgs": "build/biosensor_msgs",
    "lsl_to_ros": "ros_side/lsl_to_ros",
}
OUTLET = """
import itertools, time, pylsl
outlet = pylsl.StreamOutlet(pylsl.StreamInfo("bench", "EEG", 4, 100.0, "float32", "bench-1"))
for n in itertools.count():
    outlet.push_sample([n, n + 0.25, n + 0.5, n + 0.75])
    time.sleep(0.01)
"""
WHERE = """
import importlib.util, json
names = "biosensor_common", "biosensor_gateway", "biosensor_msgs", "lsl_to_ros"
specs = {name: importlib.util.find_spec(name) for name in names}
print(json.dumps({name: spec and spec.origin for name, spec in specs.items()}))
"""


@pytest.fixture(scope="module")
def linked_workspace(toolchain: Toolchain, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return Workspace.build(tmp_path_factory.mktemp("linked-workspace"), toolchain, linked=True)


@pytest.fixture(
    params=["workspace", pytest.param("linked_workspace", marks=pytest.mark.nightly)],
    ids=["copied", "symlinked"],
)
def built(request: pytest.FixtureRequest) -> Workspace:
    return request.getfixturevalue(request.param)


@pytest.fixture
def received() -> Generator[Callable[[str, int], list[list[float]]]]:
    rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("listener")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def receive(topic: str, count: int) -> list[list[float]]:
        """Values of the messages that came until there were enough, or for the deadline."""
        values: list[list[float]] = []

        def take(message: Float32MultiArray) -> None:
            values.append(list(message.data))

        node.create_subscription(Float32MultiArray, topic, take, QoSProfile(depth=1000))
        end = time.monotonic() + DEADLINE_S
        while len(values) < count and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        return values

    yield receive
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


@pytest.mark.timeout(BUILD_TIMEOUT_S)
def test_colcon_finds_the_ros_packages_and_nothing_else(
    toolchain: Toolchain, tmp_path: Path
) -> None:
    copy_repository(tmp_path)
    for decoy in (".venv/lib/decoy", ".uv/lib/decoy"):
        (tmp_path / decoy).mkdir(parents=True)
        (tmp_path / decoy / "setup.py").write_text("from setuptools import setup; setup()")
    packages = [line.split("\t") for line in toolchain.run(tmp_path, "colcon", "list").splitlines()]
    assert sorted(packages) == [
        ["biosensor_common", "common", "(ros.ament_python)"],
        ["biosensor_msgs", "ros_side/biosensor_msgs", "(ros.ament_cmake)"],
        ["lsl_to_ros", "ros_side/lsl_to_ros", "(ros.ament_python)"],
    ]


@pytest.mark.timeout(BUILD_TIMEOUT_S)
def test_the_ros_packages_are_built_and_tested_without_the_rest(
    toolchain: Toolchain, tmp_path: Path
) -> None:
    copy_repository(tmp_path / "all")
    (tmp_path / "src").mkdir()
    for folder in ("common", "ros_side"):
        (tmp_path / "all" / folder).rename(tmp_path / "src" / folder)
    shutil.rmtree(tmp_path / "all")
    toolchain.build(tmp_path)
    toolchain.run(tmp_path, "env", f"AMENT_PREFIX_PATH={toolchain.folder}", "colcon", "test")
    results = toolchain.run(tmp_path, "colcon", "test-result", "--all")
    ran = {
        line.partition("/")[2].partition("/")[0]: re.findall(
            r"(\d+) (test|error|failure|skipped)", line
        )
        for line in results.splitlines()
        if line.startswith("build/") and line.partition(":")[0].endswith("xml")
    }
    assert ran.keys() == PACKAGES.keys()
    for counts in ran.values():
        of = {what: int(count) for count, what in counts}
        assert of["test"] > of["skipped"]
        assert of["error"] == of["failure"] == 0


@pytest.mark.timeout(BUILD_TIMEOUT_S)
def test_the_stamped_messages_can_be_left_out(toolchain: Toolchain, tmp_path: Path) -> None:
    copy_repository(tmp_path)
    select = ("list", "--packages-up-to", "lsl_to_ros", "--names-only")
    assert set(toolchain.run(tmp_path, "colcon", *select).split()) == PACKAGES.keys()
    without = toolchain.run(tmp_path, "env", "BIOSENSOR_MSGS=0", "colcon", *select)
    assert set(without.split()) == PACKAGES.keys() - {"biosensor_msgs"}


@pytest.mark.timeout(BUILD_TIMEOUT_S)
def test_what_runs_is_what_colcon_has_built(built: Workspace) -> None:
    run, folder, python = built.toolchain.run, built.folder, built.python
    assert set(json.loads(run(folder, python, "-c", WHERE)).values()) == {None}
    origins = json.loads(run(folder, *built.command(python, "-c", WHERE)))
    for name, source in PACKAGES.items():
        expected = folder / (source if built.linked else f"install/{name}")
        assert Path(origins[name]).resolve().is_relative_to(expected.resolve())
    assert origins["biosensor_gateway"] is None


@pytest.mark.timeout(BUILD_TIMEOUT_S)
@pytest.mark.seam
def test_all_packages_are_in_ament_s_index_with_their_files(built: Workspace) -> None:
    for name in PACKAGES:
        share = built.install / name / "share"
        assert (share / "ament_index" / "resource_index" / "packages" / name).is_file()
        assert (share / name / "package.xml").is_file()
    share = built.install / "lsl_to_ros" / "share" / "lsl_to_ros"
    assert (share / "launch" / "lsl_to_ros.launch.py").is_file()
    assert (share / "config" / "params.yaml").is_file()


@pytest.mark.timeout(BUILD_TIMEOUT_S)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_the_installed_node_publishes_a_stream_and_ends_cleanly(
    built: Workspace,
    start: Callable[..., Program],
    received: Callable[[str, int], list[list[float]]],
    number: signal.Signals,
) -> None:
    start("outlet", [sys.executable, "-c", OUTLET])
    node = start("node", built.command(built.node), env=built.toolchain.environment())
    values = received("/biosensors/bench/EEG", SAMPLES)
    assert len(values) >= SAMPLES, node.output
    first = values[0][0]
    assert values == [
        [n, n + 0.25, n + 0.5, n + 0.75] for n in (first + i for i in range(len(values)))
    ]
    assert node.process.poll() is None, node.output
    node.process.send_signal(number)
    assert node.process.wait(DEADLINE_S) == 0, node.output
    assert "Traceback" not in node.output
