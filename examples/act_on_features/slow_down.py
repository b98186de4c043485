import math
import time

import rclpy
from std_msgs.msg import Float32, Float32MultiArray

CALM_BPM, GOOD_QUALITY, HOLDS_S = 100.0, 0.5, 4.0

rclpy.init()
node = rclpy.create_node("slow_down")
speed = node.create_publisher(Float32, "/speed_scale", 10)
newest = {"bpm": math.nan, "quality": math.nan, "at": -math.inf}


def received(message: Float32MultiArray) -> None:
    bpm, _age_s, quality, _motion, _intervals = message.data
    newest.update(bpm=bpm, quality=quality, at=time.monotonic())


def decide() -> None:
    is_of_now = time.monotonic() - newest["at"] < HOLDS_S
    # NaN is neither good nor calm: the robot is slow unless it knows that the person is calm.
    is_calm = is_of_now and newest["quality"] >= GOOD_QUALITY and newest["bpm"] < CALM_BPM
    scale = 1.0 if is_calm else 0.3
    print(
        f"heart rate {newest['bpm']:.0f}, quality {newest['quality']:.1f}: speed {scale}",
        flush=True,
    )
    speed.publish(Float32(data=scale))


node.create_subscription(Float32MultiArray, "/P01/biosensors/polar_h10/hr_state", received, 10)
node.create_timer(1.0, decide)
rclpy.spin(node)
