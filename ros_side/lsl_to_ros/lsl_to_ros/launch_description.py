"""Builds the launch description of a node of this package."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

NAMESPACE, NODE_NAME, PARAMS_FILE = "namespace", "node_name", "params_file"
LOG_LEVEL, RESPAWN, USE_SIM_TIME = "log_level", "respawn", "use_sim_time"
# Arguments of every node.
_COMMON_ARGUMENTS = {
    LOG_LEVEL: "debug, info, warn, error or fatal",
    RESPAWN: "true: start the node again when it ends",
    USE_SIM_TIME: "true: use the time of /clock, which is not the time of measurement",
}
_SWITCH = {"true": True, "false": False, "": False}


def description(
    executable: str, arguments: Mapping[str, str], types: dict[str, Any]
) -> LaunchDescription:
    """Declare the arguments and start one node.

    Parameters
    ----------
    executable
        Also the default of ``node_name``.
    arguments
        Descriptions by name; they include ``namespace``, ``node_name`` and ``params_file``.
    types
        Types of the arguments that are parameters of the node. Without them, YAML rules would turn
        a session named 42 into a number.
    """
    texts = {**arguments, **_COMMON_ARGUMENTS}
    declared = [_argument(name, text, executable) for name, text in texts.items()]
    start = OpaqueFunction(function=partial(_node, executable=executable, types=types))
    return LaunchDescription([*declared, start])


def _argument(name: str, text: str, executable: str) -> DeclareLaunchArgument:
    if name == NODE_NAME:
        return DeclareLaunchArgument(name, default_value=executable, description=text)
    return DeclareLaunchArgument(name, default_value="", description=f"{text}; empty: not set here")


def _existing(params_file: str) -> str:
    """Return the path of an existing file; ROS would only warn about a missing one."""
    path = Path(params_file).expanduser()
    if params_file and not path.is_file():
        message = f"params_file: there is no file {params_file}; give the path of an existing one"
        raise FileNotFoundError(message)
    return str(path) if params_file else ""


def _switch(name: str, given: str) -> bool:
    """Parse a switch; any word but true and false is an error."""
    if given.lower() not in _SWITCH:
        raise ValueError(f"{name} must be true or false, not {given!r}")
    return _SWITCH[given.lower()]


def _node(context: LaunchContext, *, executable: str, types: dict[str, Any]) -> list[Node]:
    """Make the node; an empty argument must not override the value of the parameter file."""
    params_file = _existing(LaunchConfiguration(PARAMS_FILE).perform(context))
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in (types | {USE_SIM_TIME: bool}).items()
        if LaunchConfiguration(name).perform(context)
    }
    log_level = LaunchConfiguration(LOG_LEVEL).perform(context)
    node = Node(
        package="lsl_to_ros",
        executable=executable,
        name=LaunchConfiguration(NODE_NAME),
        namespace=LaunchConfiguration(NAMESPACE),
        output="screen",
        respawn=_switch(RESPAWN, LaunchConfiguration(RESPAWN).perform(context)),
        ros_arguments=["--log-level", log_level] if log_level else [],
        # The last value wins, so arguments override the file.
        parameters=[part for part in (params_file, given) if part],
    )
    return [node]
