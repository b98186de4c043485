"""Subscribers that come, hear something and are killed at once, several at a time.

    python -m tests.faults.scenarios.killed_subscribers TOPIC ROUNDS

Of ``std_msgs/Float32MultiArray``. Prints a JSON list: the seconds until each had its
first message, null for one that had none within `PATIENCE_S`.
"""

from __future__ import annotations

import json
import os
import random
import select
import signal
import sys
import time
from typing import NamedTuple

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

AT_ONCE = 3
PATIENCE_S = 20.0
# They die while they take messages, at a moment that differs.
LIFE_S = 0.05


class Subscriber(NamedTuple):
    """A child process, and a pipe on which it says what it has heard."""

    pid: int
    heard: int

    def wait(self, until_s: float) -> bool:
        """Wait for its first message until a monotonic time; return whether it came."""
        left_s = max(0.0, until_s - time.monotonic())
        return bool(select.select([self.heard], [], [], left_s)[0])

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        os.close(self.heard)


def subscribe(topic: str) -> Subscriber:
    """Start one; by a fork, so that it need not import everything again."""
    heard, say = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(heard)
        try:
            _listen(topic, say)
        finally:
            os._exit(1)
    os.close(say)
    return Subscriber(pid, heard)


def _listen(topic: str, say: int) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node(f"subscriber_{os.getpid()}")

    def take(_: Float32MultiArray) -> None:
        os.write(say, b".")

    node.create_subscription(Float32MultiArray, topic, take, QoSProfile(depth=1000))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=PATIENCE_S)


def play_round(topic: str, moments: random.Random) -> list[float | None]:
    """Start some, wait for the first message of each, and kill all."""
    begun_s = time.monotonic()
    subscribers = [subscribe(topic) for _ in range(AT_ONCE)]
    found: list[float | None] = []
    try:
        for each in subscribers:
            came = each.wait(begun_s + PATIENCE_S)
            found.append(time.monotonic() - begun_s if came else None)
        time.sleep(moments.uniform(0.0, LIFE_S))
    finally:
        for each in subscribers:
            each.kill()
    return found


def main() -> None:
    topic, rounds = sys.argv[1], int(sys.argv[2])
    moments = random.Random(1)
    print(json.dumps([seconds for _ in range(rounds) for seconds in play_round(topic, moments)]))


if __name__ == "__main__":
    main()
