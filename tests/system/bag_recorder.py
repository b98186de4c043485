"""``python -m tests.system.bag_recorder BAG PACKAGE``: record every stamped topic as MCAP.

Like ``ros2 bag record`` it subscribes to a topic soon after it sees it, with the quality of
service that is offered there, and writes messages as they come, undecoded. PACKAGE is the
folder that holds the definitions of the messages. A topic is printed as JSON when it is
found and when its publisher has matched. SIGTERM ends the program, and then the bag is
complete.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tests.system.message_fields import message_class

# Neither is in the part of rclpy that this project's stubs describe. The usual executor
# would take most of a core for as many topics.
_executors: Any = import_module("rclpy.experimental")
_event_handlers: Any = import_module("rclpy.event_handler")

SUFFIX = "_stamped"
DEPTH = 20_000
# As often as ros2 bag record.
LOOK_S = 0.1
_NS_PER_S = 1_000_000_000


def definitions(package: Path) -> Typestore:
    """Return the messages of Jazzy and those of a package.

    Parameters
    ----------
    package
        Folder named like the ROS package; its ``msg`` has the definitions.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted((package / "msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(), f"{package.name}/msg/{file.stem}"))
    return store


class Recorder:
    """Subscribes to what appears and writes what comes."""

    def __init__(self, node: Any, writer: Writer, types: Typestore) -> None:
        self._node = node
        self._writer = writer
        self._types = types
        self._topics: set[str] = set()

    def look(self) -> None:
        """Subscribe to the stamped topics that are new."""
        for topic, kinds in self._node.get_topic_names_and_types():
            if topic.endswith(SUFFIX) and topic not in self._topics:
                offers = self._node.get_publishers_info_by_topic(topic)
                if offers:
                    self._topics.add(topic)
                    self._subscribe(topic, kinds[0], offers[0].qos_profile)

    def _subscribe(self, topic: str, kind: str, offered: Any) -> None:
        connection = self._writer.add_connection(
            topic, kind, typestore=self._types, offered_qos_profiles=[_qos(offered)]
        )

        def take(message: bytes) -> None:
            self._writer.write(connection, time.time_ns(), message)

        _say(found=topic)
        self._node.create_subscription(
            message_class(kind),
            topic,
            take,
            QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=offered.durability),
            event_callbacks=_event_handlers.SubscriptionEventCallbacks(
                matched=partial(_say_match, topic)
            ),
            raw=True,
        )


def _qos(offered: Any) -> Qos:
    """Return rclpy's quality of service as the bag's."""
    return Qos(
        history=QosHistory(int(offered.history)),
        depth=offered.depth,
        reliability=QosReliability(int(offered.reliability)),
        durability=QosDurability(int(offered.durability)),
        deadline=_time(offered.deadline),
        lifespan=_time(offered.lifespan),
        liveliness=QosLiveliness(int(offered.liveliness)),
        liveliness_lease_duration=_time(offered.liveliness_lease_duration),
        avoid_ros_namespace_conventions=offered.avoid_ros_namespace_conventions,
    )


def _time(duration: Any) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, _NS_PER_S))


def _say_match(topic: str, status: Any) -> None:
    if status.current_count:
        _say(matched=topic)


def _say(**facts: str) -> None:
    print(json.dumps(facts), flush=True)


def _until_terminated() -> Callable[[], bool]:
    """Return what tells whether to go on."""
    signals: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    return lambda: not signals


def main() -> None:
    bag, package = map(Path, sys.argv[1:])
    rclpy.init(args=[])
    goes_on = _until_terminated()
    node = rclpy.create_node("bag_recorder")
    with Writer(bag, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP) as writer:
        recorder = Recorder(node, writer, definitions(package))
        node.create_timer(LOOK_S, recorder.look)
        executor = _executors.EventsExecutor()
        executor.add_node(node)
        while goes_on():
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()


if __name__ == "__main__":
    main()
