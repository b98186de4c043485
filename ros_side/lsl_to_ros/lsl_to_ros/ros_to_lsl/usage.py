"""The text that ``--help`` shows."""

from __future__ import annotations

from lsl_to_ros.command_line import page
from lsl_to_ros.ros_to_lsl.parameters import NODE_OPTIONS, TOPIC_OPTIONS

_BEGIN = """\
Send topics of ROS 2 as streams of the Lab Streaming Layer.

  ros2 run lsl_to_ros ros_to_lsl --ros-args -p topics:="[/joint_states, /odom]"
  ros2 run lsl_to_ros ros_to_lsl --ros-args --params-file ros_to_lsl.yaml
"""
_OF_TOPIC = 'Of one topic, as in -p /odom.name:=pose, after it is in "topics":'


def usage() -> str:
    """Return the help, for a console of 80 columns."""
    of_node = {name: each.text for name, each in NODE_OPTIONS.items()}
    of_topic = {f"TOPIC.{name}": each.text for name, each in TOPIC_OPTIONS.items()}
    return page(_BEGIN, {"Parameters:": of_node, _OF_TOPIC: of_topic})
