"""Runs the node, or one of its further processes."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from biosensor_common.errors import ConfigError
from biosensor_common.relay import console_relayed
from lsl_to_ros import fastdds
from lsl_to_ros.processes.child import FURTHER
from lsl_to_ros.processes.first import LslToRos
from lsl_to_ros.processes.further import FurtherProcess


def run() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    if sys.stderr.isatty():
        # rcutils asks at each line whether it writes to a terminal, and will find a pipe.
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    # rclpy holds the GIL while it logs, so a held console would stop every thread.
    with console_relayed():
        _spin()


def _spin() -> None:
    fastdds.configure(os.environ, Path.cwd(), get_rmw_implementation_identifier())
    # Our own handlers: rclpy's end spin by an exception that ros2 run shows as a failure.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        node = _node(stopping)
    except EOFError:
        # Who has started this process is gone already.
        return
    except ConfigError as error:
        sys.stderr.write(f"lsl_to_ros: {error}\n")
        raise SystemExit(2) from error
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.1)
    finally:
        node.stop()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def _node(stopping: threading.Event) -> LslToRos | FurtherProcess:
    if sys.argv[1:2] == [FURTHER]:
        return FurtherProcess(socket.socket(fileno=int(sys.argv[2])), stopping)
    return LslToRos()
