"""Finds every LSL stream in the lab and publishes it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

import pylsl
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from biosensor_common.errors import ConfigError
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file
from biosensor_common.relay import console_relayed
from lsl_to_ros import fastdds
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.hosts import Senders
from lsl_to_ros.lsl.readers import Pump
from lsl_to_ros.lsl.sender_clocks import SenderClocks
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import (
    BURST_PACING,
    KNOWN_PEERS,
    SESSION_ID,
    STREAM_PREDICATE,
    TOPIC_PREFIX,
)
from lsl_to_ros.parameters.streams import Parameters
from lsl_to_ros.reports.reporting import Reporting
from lsl_to_ros.routing import Routing
from lsl_to_ros.topics.pacing import Pace, Pacer

LOOK_PERIOD_S = 0.1
REPORT_PERIOD_S = 1.0
# Answers that come later count, too, so a short pause costs nothing but load: at 0.1 s, 64
# streams answer so often that it takes a tenth of a core more. liblsl's own are 0.5 and 0.75 s.
SEARCH_PAUSE_S = 0.2


class LslToRos(Node):
    """One node for all streams; see the project's docs/ros-reference.md."""

    def __init__(self) -> None:
        super().__init__(
            "lsl_to_ros",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self._log = LimitedLog(self.get_logger())
        self._configure_lsl()
        self._ros_time = RosTime(self)
        self._stream_parameters = Parameters(self)
        prefix = node_parameters.declare(self, TOPIC_PREFIX)
        predicate = node_parameters.declare(self, STREAM_PREDICATE)
        warn = self._log.warn
        self._pacer = Pacer(Pace(node_parameters.declare(self, BURST_PACING)), warn)
        self._routing = Routing(
            self, prefix, self._stream_parameters, self._ros_time, self._log, self._pacer
        )
        self._discovery = Discovery(warn, predicate)
        self._pump = Pump(lambda: self._discovery.inlets)
        self._senders = Senders(warn, self._log.inform)
        self._reporting = Reporting(
            self, self._routing, self._discovery, self._senders, self._ros_time, warn
        )
        self._stream_parameters.on_change(self._apply_parameters)
        # By the node's own clock they would rest for as long as that is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
        self.create_timer(REPORT_PERIOD_S, self._reporting.report, clock=steady)
        self._sender_clocks = SenderClocks(lambda: self._discovery.inlets)
        self._pacer.start()

    def stop(self) -> None:
        """Close every inlet, and publish what has come."""
        self._sender_clocks.stop()
        self._pump.stop()
        self._discovery.stop()
        self._pacer.stop()

    def _configure_lsl(self) -> None:
        session = node_parameters.declare(self, SESSION_ID)
        peers = node_parameters.declare(self, KNOWN_PEERS)
        known_peers = tuple(peer for peer in peers if peer)
        overrides = LslOverrides(session, known_peers, search_pause_s=SEARCH_PAUSE_S)
        path = user_config_file(os.environ, Path.home(), Path.cwd())
        pylsl.set_config_content(effective_config(path, overrides))

    def _apply_parameters(self) -> None:
        self._pacer.pace.per_ms = self.get_parameter(BURST_PACING).value
        self._routing.apply_settings()
        self._discovery.set_predicate(self.get_parameter(STREAM_PREDICATE).value)
        self._routing.set_prefix(self.get_parameter(TOPIC_PREFIX).value)
        self._reporting.list_streams()

    def _look(self) -> None:
        """See what streams and what subscribers there are."""
        changes = self._discovery.update()
        if self._routing.update(changes.ready, changes.gone):
            self._reporting.list_streams()
        self._routing.count_readers()
        self._pump.look()
        self._reporting.look()
        if self._senders.look(self._discovery.inlets):
            self._reporting.report()


def run() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    if sys.stderr.isatty():
        # rcutils asks at each line whether it writes to a terminal, and will find a pipe.
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    # rclpy holds the GIL while it logs, so a held console would stop every thread.
    with console_relayed():
        _spin()


def _spin() -> None:
    fastdds.configure(os.environ, Path.cwd(), get_rmw_implementation_identifier())
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
