"""Start ``lsl_to_ros``.

``ros2 launch lsl_to_ros lsl_to_ros.launch.py namespace:=lab known_peers:="[192.168.1.20]"``

Several nodes can share the streams of a lab if they have different names:
``node_name:=lsl_eeg stream_predicate:="type='EEG'"``
"""

from typing import List

from launch import LaunchDescription

from lsl_to_ros.launch_description import description

ARGUMENTS = {
    "namespace": "namespace of the node and of its topics",
    "node_name": "name of the node; several nodes in one namespace need one each",
    "Sensor_Enable": "false: publish nothing but what the file enables again",
    "Chunk_Enable": "false: publish no chunks",
    "Chunk_Length": "samples in one chunk, 1 to 100000",
    "topic_prefix": "first part of every topic, relative to the namespace",
    "stream_predicate": "LSL query: which streams this node serves, e.g. type='EEG'",
    "processes": "not taken any more: the node runs in one process, and says so",
    "session_id": "LSL session; LabRecorder and the agents must use the same",
    "known_peers": "hosts that multicast does not reach, as a YAML list",
    "aliases": "names of sensors for streams of other programs, such as [UN-2019*=unicorn]",
    "compat": "smartlab: types and values for clients of ros2-foxy-wearable-biosensors",
    "params_file": "parameter file; the share folder's config/params.yaml is an example",
}
PARAMETER_TYPES = {
    "Sensor_Enable": bool,
    "Chunk_Enable": bool,
    "Chunk_Length": int,
    "topic_prefix": str,
    "stream_predicate": str,
    "processes": int,
    "session_id": str,
    "known_peers": List[str],
    "aliases": List[str],
    "compat": str,
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start one node."""
    return description("lsl_to_ros", ARGUMENTS, PARAMETER_TYPES)
