"""Show how old each block of ECG is when it reaches the robot.

On the lab PC: biosensor-gateway run --simulate polar_h10@P01
On the robot:  ros2 run lsl_to_ros lsl_to_ros
               python3 delay.py
Needs ROS 2 and biosensor_msgs, which is built with the node.
"""

import rclpy
from biosensor_msgs.msg import Samples
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time

rclpy.init()
node = rclpy.create_node("delay")


def received(message: Samples) -> None:
    # Each sample has the time at which it was measured, on the clock of ROS.
    newest = Time.from_msg(message.header.stamp).nanoseconds + message.offsets_ns[-1]
    age_ms = (node.get_clock().now().nanoseconds - newest) / 1e6
    lost = "unknown" if message.lost < 0 else message.lost
    print(
        f"{len(message.offsets_ns)} samples, newest {age_ms:.0f} ms old, lost: {lost}", flush=True
    )


# What waits beyond this depth is lost; docs/subscribers.md has a depth for each rate.
quality = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
node.create_subscription(Samples, "/P01/biosensors/polar_h10/ecg_stamped", received, quality)
rclpy.spin(node)
