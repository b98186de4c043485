"""Runs a node of this package as a program, until SIGINT or SIGTERM."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NoReturn

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from biosensor_common.errors import ConfigError
from biosensor_common.nonblocking_writer import console_relayed
from biosensor_common.process_limits import end_within
from biosensor_common.terminal import columns, wrapped
from lsl_to_ros import ros_environment
from lsl_to_ros.ros_environment import ensure_log_folder

Make = Callable[[threading.Event], tuple[Node, Callable[[], None]]]


def run(program: str, make: Make) -> None:
    """Run a node; exit code 0, or 2 for unusable settings.

    Parameters
    ----------
    program
        Name for console messages.
    make
        Makes the node after ROS is initialised; returns it and the function that stops it. Setting
        the event ends the program, and an EOFError ends it at once.
    """
    if sys.stderr.isatty():
        # rcutils checks at each line whether stderr is a terminal, and the relay makes it a pipe.
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    # Checked here, because behind the relay nothing is a terminal.
    width = columns(sys.stderr)

    def refuse(sentence: str) -> NoReturn:
        sys.stderr.write(f"{wrapped(f'{program}: {sentence}', width)}\n")
        raise SystemExit(2)

    # rclpy holds the GIL while it logs, so a blocked console would stop every thread.
    with console_relayed():
        _spin(make, refuse)


def _spin(make: Make, refuse: Callable[[str], NoReturn]) -> None:
    elsewhere = ensure_log_folder(os.environ)
    middleware = get_rmw_implementation_identifier()
    ros_environment.configure_fast_dds(
        os.environ, Path.cwd(), middleware, ros_environment.fast_dds_generation()
    )
    # Own signal handlers: rclpy's end spin with an exception that ros2 run shows as a failure.
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # rcl's error has no class that could be imported.
        reason = str(error).split(", at ")[0].splitlines()[0]
        refuse(f"the arguments after --ros-args cannot be read: {reason}")
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        if not stopping.is_set():
            end_within()
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        node, end = make(stopping)
    except EOFError:
        # The parent process is gone already.
        return
    except ConfigError as error:
        refuse(str(error))
    except ValueError:
        # rclpy's, and it does not tell which one.
        refuse(
            "a parameter has no value, or is an empty list, which ROS does not accept; leave it out"
        )
    if elsewhere:
        node.get_logger().warning(elsewhere)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.1)
    finally:
        end()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
