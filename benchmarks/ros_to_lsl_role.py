"""``ros_to_lsl``, watched: ``python -m benchmarks.ros_to_lsl_role TOPICS``.

It says when it has a stream of each topic, and measures from one line of its parent to the next.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Sequence

import rclpy
from rclpy.executors import SingleThreadedExecutor

from benchmarks.child import Orders, say
from benchmarks.robot_sender import topic_of
from lsl_to_ros.ros_to_lsl.application import RosToLsl
from lsl_to_ros.ros_to_lsl.topic_bridge import Bridge
from lsl_to_ros.ros_to_lsl.topic_outlets import SampleOutlet
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage

_POLL_S = 0.05
# What is on its way when the robot stops.
_LAST_S = 0.5


class Watch:
    """Times from a message's arrival, and from when it was taken, to the end of its push."""

    def __init__(self) -> None:
        self.taken_ms: list[float] = []
        self.arrived_ms: list[float] = []
        self.outlets: set[SampleOutlet] = set()
        self._taken_ns = self._arrived_ns = 0
        take, push = Bridge.take, SampleOutlet.push
        watch = self

        def noted_take(
            self: Bridge, message: RosMessage, info: MessageInfo, *, may_be_old: bool = False
        ) -> None:
            watch._taken_ns, watch._arrived_ns = time.time_ns(), info["received_timestamp"]
            take(self, message, info, may_be_old=may_be_old)

        def timed_push(self: SampleOutlet, values: Sequence[float], stamp: float) -> None:
            push(self, values, stamp)
            now_ns = time.time_ns()
            watch.outlets.add(self)
            watch.taken_ms.append((now_ns - watch._taken_ns) / 1e6)
            watch.arrived_ms.append((now_ns - watch._arrived_ns) / 1e6)

        Bridge.take = noted_take
        SampleOutlet.push = timed_push

    def restart(self) -> None:
        self.taken_ms.clear()
        self.arrived_ms.clear()


def _talk(watch: Watch, topics: int, ended: threading.Event) -> None:
    orders = Orders()

    def wait_for_order() -> None:
        while orders.poll() is None and not orders.closed.is_set():
            time.sleep(_POLL_S)

    while len(watch.outlets) < topics:
        time.sleep(_POLL_S)
    say("streaming")
    wait_for_order()
    # The robot rests, and what it has sent before is here by then.
    time.sleep(_LAST_S)
    watch.restart()
    say("measuring")
    wait_for_order()
    time.sleep(_LAST_S)
    found = {
        "taken_ms": watch.taken_ms,
        "arrived_ms": watch.arrived_ms,
        "pushed": len(watch.taken_ms),
    }
    say(json.dumps(found))
    ended.set()


def main(topics: int) -> None:
    watch, ended = Watch(), threading.Event()
    names = ", ".join(topic_of(number) for number in range(topics))
    rclpy.init(args=["--ros-args", "-p", f"topics:=[{names}]"])
    node = RosToLsl()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=_talk, args=(watch, topics, ended), daemon=True).start()
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.1)
    node.stop()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(int(sys.argv[1]))
