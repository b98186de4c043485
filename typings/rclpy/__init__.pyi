"""The part of rclpy that this project uses; rclpy's own annotations are partial."""

from collections.abc import Sequence

from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

def init(
    *,
    args: Sequence[str] | None = ...,
    domain_id: int | None = ...,
    signal_handler_options: SignalHandlerOptions | None = ...,
) -> None: ...
def ok() -> bool: ...
def shutdown() -> None: ...
def try_shutdown() -> None: ...
def create_node(node_name: str, *, namespace: str | None = ...) -> Node: ...
