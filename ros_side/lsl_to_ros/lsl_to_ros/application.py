"""Runs the node, or one of its further processes."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable

from rclpy.node import Node

from lsl_to_ros import spinning
from lsl_to_ros.command_line import FURTHER
from lsl_to_ros.processes.first import LslToRos
from lsl_to_ros.processes.further import FurtherProcess


def run() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    spinning.run("lsl_to_ros", _node)


def _node(stopping: threading.Event) -> tuple[Node, Callable[[], None]]:
    is_further = sys.argv[1:2] == [FURTHER]
    node = (
        FurtherProcess(socket.socket(fileno=int(sys.argv[2])), stopping)
        if is_further
        else LslToRos()
    )
    return node, node.stop
