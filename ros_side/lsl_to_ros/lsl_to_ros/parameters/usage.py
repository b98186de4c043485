"""The text that ``lsl_to_ros --help`` shows."""

from __future__ import annotations

from lsl_to_ros.command_line import page
from lsl_to_ros.parameters.node import TEXTS
from lsl_to_ros.parameters.streams import TEXTS as TEXTS_OF_STREAMS

_BEGIN = """\
Publish streams of the Lab Streaming Layer as topics of ROS 2.

  ros2 run lsl_to_ros lsl_to_ros
  ros2 run lsl_to_ros lsl_to_ros --ros-args -p Chunk_Length:=36
  ros2 run lsl_to_ros lsl_to_ros --ros-args --params-file lsl_to_ros.yaml
"""
_OF_STREAMS = "For all, or behind a sensor and data name, as in SENSOR.DATA.Chunk_Length:"


def usage() -> str:
    """Return the help, for a console of 80 columns."""
    return page(_BEGIN, {"Parameters:": TEXTS, _OF_STREAMS: TEXTS_OF_STREAMS})
