"""The processes of the DDS check: a node that is searched for, and one that searches.

    {"role": "look", "name": "_doctor_5f", "search_s": 5, "settle_s": 2}
    {"found": true, "seconds": 0.4, "middleware": "rmw_fastrtps_cpp", "nodes": ["/lsl_to_ros"]}

A ROS context and its libraries cannot be unloaded from a process, and the middleware may end a
process with an invalid environment.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import uuid
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from biosensor_common.doctor.probe import Request, answer, serve
from lsl_to_ros import ros_environment
from lsl_to_ros.ros_environment import ensure_log_folder

PREFIX = "_biosensor_doctor_"
"""Prefix of the nodes' names; ROS tools do not list names with a leading underscore."""
_POLL_S = 0.05


def main() -> None:
    """Run the request from stdin."""
    signal.signal(signal.SIGTERM, _leave)
    serve({"stay": _stay, "look": _look})


def _leave(_number: int, _frame: FrameType | None) -> None:
    # Exits through the context managers, so that the node announces its end.
    sys.exit(0)


def _stay(request: Request) -> None:
    """Run a node until this process is ended."""
    with _node(request["name"]):
        answer({"open": True})
        time.sleep(request["life_s"])


def _look(request: Request) -> None:
    """Search for a node, and list all others until no new one has appeared for a while."""
    search_s, settle_s = request["search_s"], request["settle_s"]
    with _node(f"{PREFIX}{uuid.uuid4().hex}") as node:
        begun = time.monotonic()
        nodes, found_s, passed_s, changed_s = list[str](), None, 0.0, 0.0
        while passed_s < search_s if found_s is None else passed_s < changed_s + settle_s:
            time.sleep(_POLL_S)
            passed_s = time.monotonic() - begun
            before, nodes = nodes, sorted(_names(node))
            if nodes != before:
                changed_s = passed_s
            if found_s is None and f"/{request['name']}" in nodes:
                found_s = passed_s
            if passed_s > search_s + settle_s:
                break
        answer(
            {
                "found": found_s is not None,
                "seconds": found_s,
                "middleware": get_rmw_implementation_identifier(),
                "nodes": [each for each in nodes if not each.startswith(f"/{PREFIX}")],
            }
        )


@contextmanager
def _node(name: str) -> Generator[Any]:
    # Starts like the node itself, so that the result is valid for it.
    middleware = get_rmw_implementation_identifier()
    ros_environment.configure_fast_dds(
        os.environ, Path.cwd(), middleware, ros_environment.fast_dds_generation()
    )
    ensure_log_folder(os.environ)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(name)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        # Other nodes list a node that vanishes without notice for many seconds.
        rclpy.try_shutdown()


def _names(node: Any) -> Iterator[str]:  # noqa: ANN401 - rclpy's own annotations are partial
    for name, namespace in node.get_node_names_and_namespaces():
        yield f"{namespace.rstrip('/')}/{name}"


if __name__ == "__main__":
    main()
