"""`colcon build` of this repository, and the node that it installs.

The build has an environment of its own, in which this project is not installed: what
runs is what colcon has built. Nothing is skipped: without git, bash, the locks or a
package index these tests fail, because they run only where they are asked for.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float32MultiArray

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[2]
UV = ROOT / ".uv" / "bin" / "uv"
# colcon needs an older setuptools than the messages' lock has, so it comes last.
LOCKS = ("ros.txt", "colcon.txt")
NODE = Path("install", "lsl_to_ros", "lib", "lsl_to_ros", "lsl_to_ros")
DEADLINE_S = 30.0
SAMPLES = 50
# The ROS wheels restart python once with their libraries' path and mark that in the
# environment: inherited, a python of another environment would load our libraries.
OF_OUR_ENVIRONMENT = (
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "AMENT_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "VIRTUAL_ENV",
)
OUTLET = """
import itertools, time, pylsl
outlet = pylsl.StreamOutlet(pylsl.StreamInfo("bench", "EEG", 4, 100.0, "float32", "bench-1"))
for n in itertools.count():
    outlet.push_sample([n, n + 0.25, n + 0.5, n + 0.75])
    time.sleep(0.01)
"""
WHERE = """
import importlib.util, json
names = "biosensor_common", "biosensor_gateway", "lsl_to_ros"
specs = {name: importlib.util.find_spec(name) for name in names}
print(json.dumps({name: spec and spec.origin for name, spec in specs.items()}))
"""


class Toolchain(NamedTuple):
    """A Python with ROS and colcon, without this project."""

    folder: Path

    @property
    def python(self) -> str:
        return str(self.folder / "bin" / "python")

    def environment(self) -> dict[str, str]:
        inherited = {k: v for k, v in os.environ.items() if k not in OF_OUR_ENVIRONMENT}
        path = f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
        return inherited | {"PATH": path, "COLCON_HOME": str(self.folder / "colcon")}

    def run(self, folder: Path, *command: str) -> str:
        result = subprocess.run(
            command,
            cwd=folder,
            env=self.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}"
        return result.stdout


class Workspace(NamedTuple):
    """A copy of this repository in which colcon has built."""

    folder: Path
    linked: bool
    toolchain: Toolchain

    def sourced(self, *command: str) -> list[str]:
        return ["bash", "-c", '. install/setup.bash && exec "$@"', "bash", *command]


@pytest.fixture(scope="module")
def toolchain(tmp_path_factory: pytest.TempPathFactory) -> Toolchain:
    made = Toolchain(tmp_path_factory.mktemp("toolchain") / "venv")
    if UV.exists():
        install = (str(UV), "pip", "install", "--quiet", "--python", made.python)
        subprocess.run([UV, "venv", "--quiet", "--python", sys.executable, made.folder], check=True)
    else:
        install = (made.python, "-m", "pip", "install", "--quiet")
        subprocess.run([sys.executable, "-m", "venv", made.folder], check=True)
    for lock in LOCKS:
        made.run(ROOT, *install, "--require-hashes", "-r", f"requirements/{lock}")
    return made


def _copy_repository(target: Path) -> None:
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
    for name in os.fsdecode(names).rstrip("\0").split("\0"):
        # A tracked file may have been deleted.
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


@pytest.fixture(scope="module", params=[False, True], ids=["copied", "symlinked"])
def workspace(
    request: pytest.FixtureRequest, toolchain: Toolchain, tmp_path_factory: pytest.TempPathFactory
) -> Workspace:
    made = Workspace(tmp_path_factory.mktemp("workspace"), request.param, toolchain)
    _copy_repository(made.folder)
    options = ["--symlink-install"] if made.linked else []
    toolchain.run(made.folder, "colcon", "build", *options)
    return made


class Program:
    """A child process that writes to a file, so that no pipe can block it."""

    def __init__(self, command: list[str], log: Path, **options: Any) -> None:
        self._log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                **options,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(errors="replace")


@pytest.fixture
def start(tmp_path: Path) -> Generator[Callable[..., Program]]:
    programs: list[Program] = []

    def start(name: str, command: list[str], **options: Any) -> Program:
        programs.append(Program(command, tmp_path / f"{name}.log", **options))
        return programs[-1]

    yield start
    for program in programs:
        program.process.kill()
        program.process.wait()


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


def test_colcon_finds_the_ros_packages_and_nothing_else(
    toolchain: Toolchain, tmp_path: Path
) -> None:
    _copy_repository(tmp_path)
    for decoy in (".venv/lib/decoy", ".uv/lib/decoy"):
        (tmp_path / decoy).mkdir(parents=True)
        (tmp_path / decoy / "setup.py").write_text("from setuptools import setup; setup()")
    packages = [line.split("\t") for line in toolchain.run(tmp_path, "colcon", "list").splitlines()]
    assert packages == [
        ["biosensor_common", "common", "(ros.ament_python)"],
        ["lsl_to_ros", "ros_side/lsl_to_ros", "(ros.ament_python)"],
    ]


def test_what_runs_is_what_colcon_has_built(workspace: Workspace) -> None:
    run, folder, python = workspace.toolchain.run, workspace.folder, workspace.toolchain.python
    assert set(json.loads(run(folder, python, "-c", WHERE)).values()) == {None}
    origins = json.loads(run(folder, *workspace.sourced(python, "-c", WHERE)))
    sources = {"biosensor_common": "common", "lsl_to_ros": "ros_side/lsl_to_ros"}
    for name, source in sources.items():
        expected = folder / (source if workspace.linked else f"install/{name}")
        assert Path(origins[name]).resolve().is_relative_to(expected.resolve())
    assert origins["biosensor_gateway"] is None


def test_both_packages_are_in_ament_s_index_with_their_files(workspace: Workspace) -> None:
    install = workspace.folder / "install"
    for name in ("biosensor_common", "lsl_to_ros"):
        share = install / name / "share"
        assert (share / "ament_index" / "resource_index" / "packages" / name).is_file()
        assert (share / name / "package.xml").is_file()
    share = install / "lsl_to_ros" / "share" / "lsl_to_ros"
    assert (share / "launch" / "lsl_to_ros.launch.py").is_file()
    assert (share / "config" / "params.yaml").is_file()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_the_installed_node_publishes_a_stream_and_ends_cleanly(
    workspace: Workspace,
    start: Callable[..., Program],
    received: Callable[[str, int], list[list[float]]],
    number: signal.Signals,
) -> None:
    start("outlet", [sys.executable, "-c", OUTLET])
    node = start(
        "node",
        workspace.sourced(str(NODE)),
        cwd=workspace.folder,
        env=workspace.toolchain.environment(),
    )
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
