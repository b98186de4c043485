"""``lsl_to_ros``: finds every LSL stream in the lab and publishes it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

import pylsl
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from biosensor_common.errors import ConfigError
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file
from lsl_to_ros.diagnostics import stream_status
from lsl_to_ros.discovery import Discovery
from lsl_to_ros.parameters import Parameters
from lsl_to_ros.ros_time import RosTime
from lsl_to_ros.routing import Routing

DISCOVERY_PERIOD_S = 0.25
DIAGNOSTICS_PERIOD_S = 1.0
CORRECTION_PERIOD_S = 1.0
CORRECTION_TIMEOUT_S = 5.0


class LslToRos(Node):
    """One node for all streams; see the package's README for topics and parameters."""

    def __init__(self) -> None:
        super().__init__(
            "lsl_to_ros",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        prefix = self._read_only("topic_prefix", "biosensors", "first part of every topic")
        self._configure_lsl()
        self._ros_time = RosTime(self)
        stream_parameters = Parameters(self)
        self._routing = Routing(self, prefix, stream_parameters, self._ros_time)
        stream_parameters.on_change(self._routing.apply_settings)
        self._discovery = Discovery(self._warn)
        self._diagnostics_topic = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(DISCOVERY_PERIOD_S, self._discover)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._report)
        self._stopping = threading.Event()
        threading.Thread(target=self._measure_corrections, daemon=True).start()

    def stop(self) -> None:
        """Close every inlet."""
        self._stopping.set()
        self._discovery.stop()

    def _read_only(self, name: str, default: Any, description: str) -> Any:  # noqa: ANN401 - any parameter
        given = self.get_parameter_or(name).value
        if given is not None:
            self.undeclare_parameter(name)
        value = default if given is None else given
        descriptor = ParameterDescriptor(description=description, read_only=True)
        return self.declare_parameter(name, value, descriptor, ignore_override=True).value

    def _configure_lsl(self) -> None:
        session = self._read_only("session_id", "", "LSL session; empty: LSL's own setting")
        peers = self._read_only("known_peers", [""], "hosts that multicast does not reach")
        overrides = LslOverrides(session, tuple(peer for peer in peers if peer))
        path = user_config_file(os.environ, Path.home(), Path.cwd())
        pylsl.set_config_content(effective_config(path, overrides))

    def _warn(self, sentence: str) -> None:
        self.get_logger().warning(sentence)

    def _discover(self) -> None:
        changes = self._discovery.update()
        self._routing.update(changes.ready, changes.gone)

    def _report(self) -> None:
        step = self._ros_time.refresh()
        if step is not None:
            self._warn(f"the system clock jumped by {step.size_ns / 1e9:.6f} s; stamps follow")
        now = pylsl.local_clock()
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for route in self._routing.routes:
            if route.bridge is not None and route.topic is not None:
                correction = route.inlet.correction
                age = now - route.bridge.last_stamp - (correction or 0.0)
                rate = route.meter.rate(route.bridge.received, route.bridge.last_stamp)
                array.status.append(stream_status(route.topic, route.bridge, rate, age, correction))
        self._diagnostics_topic.publish(array)

    def _measure_corrections(self) -> None:
        """Clock offsets take a round trip each, so they are measured beside the data's path."""
        while not self._stopping.wait(CORRECTION_PERIOD_S):
            for inlet in self._discovery.inlets:
                if self._stopping.is_set():
                    return
                inlet.measure_correction(CORRECTION_TIMEOUT_S)


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    # Our own handlers: rclpy's end spin by an exception that ros2 run shows as a failure.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        node = LslToRos()
    except ConfigError as error:
        sys.stderr.write(f"lsl_to_ros: {error}\n")
        raise SystemExit(2) from error
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.1)
    finally:
        node.stop()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
