import math
import time

import py_trees
import rclpy
from py_trees.common import Status
from std_msgs.msg import Float32, Float32MultiArray

HOLDS_S = 4.0
GOOD_QUALITY = 0.5


class HeartRateBelow(py_trees.behaviour.Behaviour):
    """Succeeds while a good heart rate of now is below a limit, and fails when there is none."""

    def __init__(self, node, topic, limit_bpm):
        super().__init__(f"heart rate below {limit_bpm:.0f}")
        self.limit_bpm = limit_bpm
        self.bpm, self.quality, self.heard_s = math.nan, math.nan, -math.inf
        node.create_subscription(Float32MultiArray, topic, self.heard, 10)

    def heard(self, message):
        self.bpm, _age_s, self.quality, _motion, _intervals = message.data
        self.heard_s = time.monotonic()

    def update(self):
        is_of_now = time.monotonic() - self.heard_s < HOLDS_S
        is_good = self.quality >= GOOD_QUALITY  # not of NaN either
        is_calm = is_of_now and is_good and self.bpm < self.limit_bpm
        return Status.SUCCESS if is_calm else Status.FAILURE


class SetSpeed(py_trees.behaviour.Behaviour):
    """Tells the robot how fast it may move, 0 to 1."""

    def __init__(self, publisher, scale):
        super().__init__(f"speed {scale}")
        self.publisher, self.scale = publisher, scale

    def update(self):
        self.publisher.publish(Float32(data=self.scale))
        return Status.SUCCESS


rclpy.init()
node = rclpy.create_node("tree")
speed = node.create_publisher(Float32, "/speed_scale", 10)
calm = py_trees.composites.Sequence("calm", memory=False)
calm.add_child(HeartRateBelow(node, "/P01/biosensors/polar_h10/hr_state", limit_bpm=100.0))
calm.add_child(SetSpeed(speed, 1.0))
root = py_trees.composites.Selector("approach", memory=False)
root.add_children([calm, SetSpeed(speed, 0.3)])
node.create_timer(0.1, root.tick_once)
rclpy.spin(node)
