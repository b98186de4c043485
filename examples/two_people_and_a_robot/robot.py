import math

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

rclpy.init()
robot = rclpy.create_node("robot")
joints = robot.create_publisher(JointState, "/joint_states", 10)
events = robot.create_publisher(String, "/robot/event", 10)


def move() -> None:
    now = robot.get_clock().now()
    angle = now.nanoseconds / 1e9 % (2 * math.pi)
    message = JointState(name=["shoulder", "elbow"])
    message.header.stamp = now.to_msg()
    message.position = [math.sin(angle), math.cos(angle)]
    joints.publish(message)


robot.create_timer(0.01, move)
robot.create_timer(2.0, lambda: events.publish(String(data="handover")))
rclpy.spin(robot)
