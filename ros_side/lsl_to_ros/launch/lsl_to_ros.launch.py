"""Start ``lsl_to_ros``.

``ros2 launch lsl_to_ros lsl_to_ros.launch.py namespace:=lab known_peers:="[192.168.1.20]"``

Several nodes share the streams of a lab, each under a name of its own:
``node_name:=lsl_eeg stream_predicate:="type='EEG'"``
"""

from typing import List

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

DEFAULTS = {"node_name": "lsl_to_ros"}
ARGUMENTS = {
    "namespace": "namespace of the node and of its topics",
    "node_name": "name of the node; several nodes in one namespace need one each",
    "topic_prefix": "first part of every topic, relative to the namespace",
    "stream_predicate": "LSL query: which streams this node serves, e.g. type='EEG'",
    "processes": "processes that share the streams, each on a core of its own, 1 to 16",
    "session_id": "LSL session; LabRecorder and the agents must use the same",
    "known_peers": "hosts that multicast does not reach, as a YAML list",
    "params_file": "parameter file; the share folder's config/params.yaml is an example",
}
# Without these types, YAML rules would make a number of a session named 42.
PARAMETER_TYPES = {
    "topic_prefix": str,
    "stream_predicate": str,
    "processes": int,
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
        executable="lsl_to_ros",
        name=LaunchConfiguration("node_name"),
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        # The last one wins.
        parameters=[part for part in (params_file, given) if part],
    )
    return [node]
