"""ROS's two ends: ``python -m tests.bench.ros_roles send|receive TOPIC COUNT TIMES_FILE``."""

from __future__ import annotations

import sys
import threading
from array import array
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

from tests.bench.roles import TOPIC_DEPTH, Arrivals, send_on_schedule, told_by_parent


def send(topic: str, count: int, times_file: Path) -> None:
    """Publish from a plain thread, as ``lsl_to_ros`` does."""
    node = rclpy.create_node("bench_sender")
    publisher = node.create_publisher(Float32MultiArray, topic, QoSProfile(depth=TOPIC_DEPTH))

    def message_of(values: list[float]) -> Float32MultiArray:
        return Float32MultiArray(data=array("f", values))

    thread = threading.Thread(
        target=send_on_schedule, args=(message_of, publisher.publish, count, times_file)
    )
    thread.start()
    thread.join()


def receive(topic: str, count: int, times_file: Path) -> None:
    """Take messages in a subscription's callback."""
    told, arrivals = told_by_parent(), Arrivals(count)
    node = rclpy.create_node("bench_receiver")

    def take(message: Float32MultiArray) -> None:
        arrivals.add(message.data[0])

    node.create_subscription(Float32MultiArray, topic, take, QoSProfile(depth=TOPIC_DEPTH))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not told.is_set():
        executor.spin_once(timeout_sec=0.1)
    arrivals.write(times_file)


if __name__ == "__main__":
    rclpy.init()
    role = {"send": send, "receive": receive}[sys.argv[1]]
    role(sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]))
    rclpy.shutdown()
