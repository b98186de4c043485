"""Messages, and what ROS tells of them besides."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from lsl_to_ros.subscriber_thread import MessageInfo

NOW_NS = 1_790_000_000_000_000_000
MILLISECOND = 1_000_000


def info(source_ns: int, delay_ns: int = MILLISECOND // 2, number: int | None = 1) -> MessageInfo:
    return MessageInfo(
        source_timestamp=source_ns,
        received_timestamp=source_ns + delay_ns,
        publication_sequence_number=number,
    )


def stamped(message: Any, stamp_ns: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    # Of its own: tests of other folders may run in this process, too.
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    yield context
    rclpy.shutdown(context=context)


@pytest.fixture
def make_node(context: Context) -> Iterator[Callable[..., Node]]:
    nodes: list[Node] = []

    def make(name: str, **options: Any) -> Node:
        nodes.append(Node(name, context=context, **options))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
