"""Serving a node until the parent has had enough."""

from __future__ import annotations

from typing import Any

import rclpy.experimental
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from benchmarks.child import Orders

_WAIT_S = 0.1


def events_executor(node: Node) -> SingleThreadedExecutor:
    """Return an executor that costs a quarter of rclpy's usual one."""
    experimental: Any = rclpy.experimental
    executor: SingleThreadedExecutor = experimental.EventsExecutor()
    executor.add_node(node)
    return executor


def usual_executor(node: Node) -> SingleThreadedExecutor:
    """Return the executor of :func:`rclpy.spin`."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    return executor


def spin(executor: SingleThreadedExecutor, orders: Orders) -> None:
    """Serve callbacks until the parent closes the pipe."""
    while not orders.closed.is_set():
        executor.spin_once(timeout_sec=_WAIT_S)
