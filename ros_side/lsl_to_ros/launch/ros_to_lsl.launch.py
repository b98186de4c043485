"""Start ``ros_to_lsl``.

``ros2 launch lsl_to_ros ros_to_lsl.launch.py topics:="[/joint_states, /odom]"``

What belongs to one topic alone, such as its fields, is in a parameter file:
``params_file:=ros_to_lsl.yaml``
"""

from typing import List

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

DEFAULTS = {"node_name": "ros_to_lsl"}
ARGUMENTS = {
    "namespace": "namespace of the node, and of topics without a leading slash",
    "node_name": "name of the node; several nodes in one namespace need one each",
    "topics": "topics to send, as a YAML list",
    "all_small": "true: send every topic but images and other bytes without a limit",
    "stamps": "measured, or arrival",
    "session_id": "LSL session; LabRecorder and the agents must use the same",
    "known_peers": "hosts that multicast does not reach, as a YAML list",
    "params_file": "parameter file; the share folder's config/ros_to_lsl.yaml is an example",
}
# Without these types, YAML rules would make a number of a session named 42.
PARAMETER_TYPES = {
    "topics": List[str],
    "all_small": bool,
    "stamps": str,
    "session_id": str,
    "known_peers": List[str],
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start one node."""
    arguments = [_argument(name, text) for name, text in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=_start_node)])


def _argument(name: str, text: str) -> DeclareLaunchArgument:
    default = DEFAULTS.get(name, "")
    description = text if default else f"{text}; empty: not set here"
    return DeclareLaunchArgument(name, default_value=default, description=description)


def _start_node(context: LaunchContext) -> list[Node]:
    """Make the node from what was given: an empty value must not overrule the file's."""
    params_file = LaunchConfiguration("params_file").perform(context)
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in PARAMETER_TYPES.items()
        if LaunchConfiguration(name).perform(context)
    }
    node = Node(
        package="lsl_to_ros",
        executable="ros_to_lsl",
        name=LaunchConfiguration("node_name"),
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        # The last one wins.
        parameters=[part for part in (params_file, given) if part],
    )
    return [node]
