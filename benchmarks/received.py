"""Says how many samples the node has got of each stream: ``python -m benchmarks.received``.

Each order is answered by one line of JSON, by topic, from the newest report on ``/diagnostics``.
"""

from __future__ import annotations

import json

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from benchmarks import ros_executor
from benchmarks.child import Orders, say


def watch() -> None:
    """Answer until the parent closes the pipe."""
    orders, node = Orders(), rclpy.create_node("bench_received")
    received: dict[str, int] = {}

    def take(report: DiagnosticArray) -> None:
        for status in report.status:
            values = {pair.key: pair.value for pair in status.values}
            if "received" in values:
                received[values["topic"]] = int(values["received"])

    def answer() -> None:
        if orders.poll() is not None:
            say(json.dumps(received))

    node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    node.create_timer(0.1, answer)
    ros_executor.spin(ros_executor.usual_executor(node), orders)


if __name__ == "__main__":
    rclpy.init()
    watch()
    rclpy.shutdown()
