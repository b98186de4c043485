"""The launch files, read by ROS's own front ends and started; run by ``colcon test``."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# There are no wheels of it; a ROS machine has it by the manifest.
pytest.importorskip("launch_ros")

import rclpy
from launch import LaunchContext
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch_ros.actions import Node
from launch_ros.utilities import evaluate_parameters
from rcl_interfaces.srv import GetParameters

DEADLINE_S = 60.0
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
given = [tuple(each.split(":=")) for each in sys.argv[2:]]
source = AnyLaunchDescriptionSource(sys.argv[1])
included = IncludeLaunchDescription(source, launch_arguments=given)
service = LaunchService()
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""
STARTED = re.compile(r"process started with pid \[(\d+)\]")
FOLDER = Path(__file__).parents[1] / "launch"
NODES = ("lsl_to_ros", "ros_to_lsl")
FORMS = ("py", "xml", "yaml")
GIVEN = {
    "namespace": "lab",
    "node_name": "mine",
    "session_id": "42",
    "known_peers": "[a, b]",
    "log_level": "debug",
    "respawn": "true",
}


def _source(node: str, form: str) -> AnyLaunchDescriptionSource:
    return AnyLaunchDescriptionSource(str(FOLDER / f"{node}.launch.{form}"))


def _arguments(node: str, form: str) -> dict[str, tuple[str, str]]:
    context = LaunchContext()
    description = _source(node, form).get_launch_description(context)
    return {
        argument.name: (
            "".join(part.perform(context) for part in argument.default_value or ()),
            argument.description,
        )
        for argument in description.get_launch_arguments()
    }


def _nodes(entities: Any, context: LaunchContext) -> list[Node]:
    found: list[Node] = []
    for entity in entities or ():
        found += [entity] if isinstance(entity, Node) else _nodes(entity.visit(context), context)
    return found


def _parameters(node: str, form: str, given: dict[str, str]) -> tuple[Any, ...]:
    context = LaunchContext()
    context.launch_configurations.update(given)
    (made,) = _nodes([IncludeLaunchDescription(_source(node, form))], context)
    return made.node_package, evaluate_parameters(context, made._Node__parameters)


@pytest.mark.parametrize("node", NODES)
def test_each_form_takes_the_same_arguments(node: str) -> None:
    python, *others = (_arguments(node, form) for form in FORMS)
    assert {"namespace", "params_file", "log_level", "respawn"} < python.keys()
    assert others == [python, python]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("node", NODES)
def test_each_form_hands_on_what_is_given_and_nothing_else(node: str, form: str) -> None:
    assert _parameters(node, form, {}) == ("lsl_to_ros", ())
    package, (parameters,) = _parameters(node, form, GIVEN)
    assert package == "lsl_to_ros"
    # A session named 42 stays a text, and names stay a list.
    assert parameters == {"session_id": "42", "known_peers": ["a", "b"]}


@pytest.fixture
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let LSL and ROS see this test only."""
    settings = tmp_path / "lsl_api.cfg"
    settings.write_text(f"[lab]\nSessionID = test-{uuid.uuid4().hex}\n[log]\nlevel = -2\n")
    monkeypatch.setenv("LSLAPICFG", str(settings))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random.randrange(1, 102)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))


@pytest.fixture
def asking(_alone: None) -> Iterator[rclpy.node.Node]:
    rclpy.init(args=[])
    node = rclpy.create_node("asking")
    yield node
    node.destroy_node()
    rclpy.shutdown()


def _goes_by_clock(node: rclpy.node.Node, name: str) -> bool:
    """Ask another node for its ``use_sim_time``, as soon as it answers."""
    client = node.create_client(GetParameters, f"{name}/get_parameters")
    end = time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        # A question to a node that has just been killed is never answered.
        answer = client.call_async(GetParameters.Request(names=["use_sim_time"]))
        rclpy.spin_until_future_complete(node, answer, timeout_sec=2.0)
        if answer.done():
            return answer.result().values[0].bool_value
    raise TimeoutError(f"{name} does not answer")


def _started(said: Path, count: int) -> int:
    """Wait until launch has started a process so often; return the last one's number."""
    end = time.monotonic() + DEADLINE_S
    while len(found := STARTED.findall(said.read_text())) < count:
        assert time.monotonic() < end, said.read_text()
        time.sleep(0.1)
    return int(found[-1])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("node", NODES)
def test_each_form_starts_the_node_as_asked_and_again_when_it_dies(
    node: str, form: str, asking: rclpy.node.Node, tmp_path: Path
) -> None:
    said = tmp_path / "said.txt"
    given = ("namespace:=lab", "node_name:=mine", "use_sim_time:=true")
    given += ("log_level:=debug", "respawn:=true")
    # It sends what it is told, and has no other use of simulated time.
    given += ("topics:=[/joint_states]", "stamps:=arrival") if node == "ros_to_lsl" else ()
    command = [sys.executable, "-c", LAUNCH, str(FOLDER / f"{node}.launch.{form}"), *given]
    with (
        said.open("w") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as launched,
    ):
        try:
            first = _started(said, 1)
            assert _goes_by_clock(asking, "/lab/mine")
            os.kill(first, signal.SIGKILL)
            assert _started(said, 2) != first
            assert _goes_by_clock(asking, "/lab/mine")
        finally:
            launched.send_signal(signal.SIGINT)
            launched.wait(DEADLINE_S)
    assert "[DEBUG]" in said.read_text()
    assert "Traceback" not in said.read_text()
