"""Start ``ros_to_lsl``.

``ros2 launch lsl_to_ros ros_to_lsl.launch.py topics:="[/joint_states, /odom]"``

Settings of a single topic, such as its fields, belong in a parameter file:
``params_file:=ros_to_lsl.yaml``
"""

from typing import List

from launch import LaunchDescription

from lsl_to_ros.launch_description import description

ARGUMENTS = {
    "namespace": "namespace of the node, and of topics without a leading slash",
    "node_name": "name of the node; several nodes in one namespace need one each",
    "topics": "topics to send, as a YAML list",
    "all_small": "true: send every topic except images and other bytes without a size limit",
    "stamps": "measured, or arrival",
    "session_id": "LSL session; LabRecorder and the agents must use the same",
    "known_peers": "hosts that multicast does not reach, as a YAML list",
    "params_file": "parameter file; the share folder's config/ros_to_lsl.yaml is an example",
}
PARAMETER_TYPES = {
    "topics": List[str],
    "all_small": bool,
    "stamps": str,
    "session_id": str,
    "known_peers": List[str],
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start one node."""
    return description("ros_to_lsl", ARGUMENTS, PARAMETER_TYPES)
