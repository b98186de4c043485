"""The node ``lsl_to_ros``, which publishes LSL streams as topics."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.lsl.sender_clocks import SenderClocks
from lsl_to_ros import program
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.inlets import Pump, Senders
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import (
    ALIASES,
    BURST_PACING,
    COMPAT,
    DIAGNOSTICS_PERIOD,
    KNOWN_PEERS,
    SESSION_ID,
    STREAM_PREDICATE,
    TOPIC_PREFIX,
)
from lsl_to_ros.parameters.streams import Parameters
from lsl_to_ros.reports.clock_pairs import CLOCK_PERIOD_S, ClockPairs
from lsl_to_ros.reports.reporter import Reporting, Survey, stream_list
from lsl_to_ros.routes import Routing
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.topics.lanes import Pace, Pacer

LOOK_PERIOD_S = 0.1
REPORT_PERIOD_S = 1.0
# Later answers count, too, so a short pause costs only load: at 0.1 s, 64
# streams answer so often that it takes a tenth of a core more. liblsl's own are 0.5 and 0.75 s.
SEARCH_PAUSE_S = 0.2


def run() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    program.run("lsl_to_ros", _node)


def _node(_stopping: threading.Event) -> tuple[Node, Callable[[], None]]:
    node = LslToRos()
    return node, node.stop


class LslToRos(Node):
    """One node for all streams; see the project's docs/ros-reference.md.

    Raises
    ------
    ConfigError
        If a parameter is wrong or misspelt.
    """

    def __init__(self) -> None:
        super().__init__(
            "lsl_to_ros",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self._stream_parameters = Parameters(self)
        node_parameters.declare(self, DIAGNOSTICS_PERIOD)
        self._log = LimitedLog(self.get_logger())
        session = node_parameters.declare(self, SESSION_ID)
        peers = node_parameters.peers_of(node_parameters.declare(self, KNOWN_PEERS))
        configure_lsl(LslOverrides(session, peers, search_pause_s=SEARCH_PAUSE_S))
        self._ros_time = RosTime(self)
        prefix = node_parameters.declare(self, TOPIC_PREFIX)
        predicate = node_parameters.declare(self, STREAM_PREDICATE)
        aliases = node_parameters.aliases_of(node_parameters.declare(self, ALIASES))
        warn = self._log.warn
        self._pacer = Pacer(Pace(node_parameters.declare(self, BURST_PACING)), warn)
        self._routing = Routing(
            self,
            prefix,
            self._stream_parameters,
            self._ros_time,
            self._log,
            self._pacer,
            aliases,
            is_as_original=bool(node_parameters.declare(self, COMPAT)),
        )
        self._discovery = Discovery(warn, predicate)
        self._pump = Pump(lambda: self._discovery.inlets)
        self._senders = Senders(warn, self._log.inform)
        self._survey = Survey(self, self._routing, self._discovery, self._senders, warn)
        self._reporting = Reporting(self, self._ros_time, warn)
        self._stream_parameters.on_change(self._apply_parameters)
        self._stream_parameters.on_set(self._tell_of_keys_without_stream)
        self._sender_clocks = SenderClocks(lambda: self._discovery.inlets)
        self._clock_pairs = ClockPairs(self, warn)
        # With the node's own clock the timers would stop for as long as that is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CLOCK_PERIOD_S, self._clock_pairs.look, clock=steady)
        self.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
        self.create_timer(REPORT_PERIOD_S, self._report, clock=steady)
        self._pacer.start()

    def stop(self) -> None:
        """Close every inlet, and publish the samples received so far."""
        self._clock_pairs.close()
        self._sender_clocks.stop()
        self._pump.stop()
        self._discovery.stop()
        self._pacer.stop()

    def _look(self) -> None:
        """Update the streams and the subscribers."""
        ready, gone = self._discovery.update()
        if self._routing.update(ready, gone):
            self._list_streams()
        self._routing.count_readers()
        self._pump.look()
        self._survey.look()
        if self._senders.look(self._discovery.inlets):
            self._report()

    def _report(self) -> None:
        jump_ns = self._ros_time.refresh()
        if jump_ns is not None:
            self._log.warn(
                f"the system clock jumped by {jump_ns / 1e9:.6f} s; timestamps follow it"
            )
        self._reporting.report(self._survey.part())

    def _list_streams(self) -> None:
        self._reporting.list_streams(stream_list(self._routing.routes))

    def _apply_parameters(self) -> None:
        value = self.get_parameter
        self._pacer.pace.per_ms = value(BURST_PACING).value
        self._routing.apply_settings()
        self._discovery.set_predicate(value(STREAM_PREDICATE).value)
        self._routing.set_prefix(value(TOPIC_PREFIX).value)
        self._list_streams()

    def _tell_of_keys_without_stream(self, parameters: Sequence[Parameter]) -> None:
        for sentence in self._stream_parameters.without_stream(parameters):
            self._log.warn(sentence)
