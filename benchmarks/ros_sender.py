"""DDS alone, sending end: ``python -m benchmarks.ros_sender TOPIC``."""

from __future__ import annotations

import sys
import threading
from array import array

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

from benchmarks.child import Orders
from benchmarks.samples import RATE_HZ, values_of
from benchmarks.schedule import Schedule


def run(topic: str) -> None:
    """Publish from a plain thread, as ``lsl_to_ros`` does."""
    node = rclpy.create_node("bench_sender")
    publisher = node.create_publisher(Float32MultiArray, topic, QoSProfile(depth=int(RATE_HZ)))

    def message_of(number: float) -> Float32MultiArray:
        return Float32MultiArray(data=array("f", values_of(number)))

    def send(message: Float32MultiArray, _due: float) -> None:
        publisher.publish(message)

    schedule = Schedule(message_of, [send], RATE_HZ)
    thread = threading.Thread(target=schedule.run, args=(Orders(),))
    thread.start()
    thread.join()


if __name__ == "__main__":
    rclpy.init()
    run(sys.argv[1])
    rclpy.shutdown()
