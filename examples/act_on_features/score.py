import math
import statistics

import rclpy
from std_msgs.msg import Float32

rclpy.init()
node = rclpy.create_node("score")
scores = node.create_publisher(Float32, "/P01/hr_above_rest", 10)
rest = []


def heard(message):
    if math.isnan(message.data):
        return
    if len(rest) < 60:
        rest.append(message.data)
    elif (spread := statistics.stdev(rest)) > 0:
        scores.publish(Float32(data=(message.data - statistics.mean(rest)) / spread))


node.create_subscription(Float32, "/P01/biosensors/polar_h10/hr_live", heard, 10)
rclpy.spin(node)
