"""The launch files, read by ROS's own front ends; run by ``colcon test``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

# There are no wheels of it; a ROS machine has it by the manifest.
pytest.importorskip("launch_ros")

from launch import LaunchContext
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch_ros.actions import Node
from launch_ros.utilities import evaluate_parameters

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
