"""The text that ``--help`` shows."""

from __future__ import annotations

from textwrap import fill

from lsl_to_ros.ros_to_lsl.parameters import NODE_OPTIONS, TOPIC_OPTIONS

_WIDTH, _INDENT = 80, 18
_BEGIN = """\
Send topics of ROS 2 as streams of the Lab Streaming Layer.

  ros2 run lsl_to_ros ros_to_lsl --ros-args -p topics:="[/joint_states, /odom]"
  ros2 run lsl_to_ros ros_to_lsl --ros-args --params-file ros_to_lsl.yaml
"""


def usage() -> str:
    """Return the help, for a console of 80 columns."""
    of_node = [_line(name, each.text) for name, each in NODE_OPTIONS.items()]
    of_topic = [_line(f"TOPIC.{name}", each.text) for name, each in TOPIC_OPTIONS.items()]
    heads = "Parameters:", 'Of one topic, as in -p /odom.name:=pose, after it is in "topics":'
    return "\n".join([_BEGIN, heads[0], *of_node, "", heads[1], *of_topic, ""])


def _line(name: str, text: str) -> str:
    first = f"  {name.ljust(_INDENT - 2)}"
    return fill(text, _WIDTH, initial_indent=first, subsequent_indent=" " * _INDENT)
