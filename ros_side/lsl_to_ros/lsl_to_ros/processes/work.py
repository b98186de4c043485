"""Reads one share of the streams and publishes it: the work of each process of the node."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from biosensor_common.lsl.sender_clocks import SenderClocks
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.lsl.configuration import configure_lsl
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.hosts import Senders
from lsl_to_ros.lsl.readers import Pump
from lsl_to_ros.lsl.share import Share
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import (
    ALIASES,
    BURST_PACING,
    COMPAT,
    KNOWN_PEERS,
    SESSION_ID,
    STREAM_PREDICATE,
    TOPIC_PREFIX,
)
from lsl_to_ros.parameters.streams import Parameters
from lsl_to_ros.reports.stream_list import stream_list
from lsl_to_ros.reports.survey import Part, Survey
from lsl_to_ros.routing import Routing
from lsl_to_ros.topics.pacing import Pace, Pacer
from lsl_to_ros.topics.register import Names

LOOK_PERIOD_S = 0.1
REPORT_PERIOD_S = 1.0
# Answers that come later count, too, so a short pause costs nothing but load: at 0.1 s, 64
# streams answer so often that it takes a tenth of a core more. liblsl's own are 0.5 and 0.75 s.
SEARCH_PAUSE_S = 0.2


class Work:
    """Everything from the streams to the topics, in one process.

    Parameters
    ----------
    names
        By what topics are named.
    listed
        Called when the list of streams has changed.
    reported
        Called once a second, and with True when it should not wait.

    Attributes
    ----------
    parameters
        Of the node.
    """

    def __init__(
        self,
        node: Node,
        share: Share,
        names: Names,
        listed: Callable[[], None],
        reported: Callable[[bool], None],
    ) -> None:
        self._node = node
        self._listed, self._reported = listed, reported
        self.log = LimitedLog(node.get_logger())
        _configure_lsl(node)
        self.ros_time = RosTime(node)
        self.parameters = Parameters(node)
        prefix = node_parameters.declare(node, TOPIC_PREFIX)
        predicate = node_parameters.declare(node, STREAM_PREDICATE)
        aliases = node_parameters.aliases_of(node_parameters.declare(node, ALIASES))
        warn = self.log.warn
        # What all processes see is said by the first of them.
        is_first = share.index == 0
        self._warn_for_all = warn if is_first else _say_nothing
        inform_for_all = self.log.inform if is_first else _say_nothing
        self._pacer = Pacer(Pace(node_parameters.declare(node, BURST_PACING)), warn)
        self._routing = Routing(
            node,
            prefix,
            names,
            self.parameters,
            self.ros_time,
            self.log,
            self._pacer,
            aliases,
            is_as_original=bool(node_parameters.declare(node, COMPAT)),
        )
        self._discovery = Discovery(warn, predicate, share)
        self._pump = Pump(lambda: self._discovery.inlets)
        self._senders = Senders(self._warn_for_all, inform_for_all)
        self._survey = Survey(
            node,
            self._routing,
            self._discovery,
            self._senders,
            warn,
            share,
        )
        self.parameters.on_change(self._apply_parameters)
        self._sender_clocks = SenderClocks(lambda: self._discovery.inlets)

    def start(self) -> None:
        """Begin to look at streams, and to report."""
        # By the node's own clock they would rest for as long as that is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
        self._node.create_timer(REPORT_PERIOD_S, lambda: self._reported(False), clock=steady)
        self._pacer.start()

    def stop(self) -> None:
        """Close every inlet, and publish what has come."""
        self._sender_clocks.stop()
        self._pump.stop()
        self._discovery.stop()
        self._pacer.stop()

    def part(self) -> Part:
        """Return what there is to report; call it once a second."""
        jump_ns = self.ros_time.refresh()
        if jump_ns is not None:
            jump = f"the system clock jumped by {jump_ns / 1e9:.6f} s; stamps follow"
            self._warn_for_all(jump)
        return self._survey.part()

    def topics(self) -> list[DiagnosticStatus]:
        """Return the list of streams."""
        return stream_list(self._routing.routes)

    def map_topics(self) -> None:
        """Give the streams their topics, since other processes have others now."""
        self._routing.map_topics()
        self._listed()

    def _apply_parameters(self) -> None:
        value = self._node.get_parameter
        self._pacer.pace.per_ms = value(BURST_PACING).value
        self._routing.apply_settings()
        self._discovery.set_predicate(value(STREAM_PREDICATE).value)
        self._routing.set_prefix(value(TOPIC_PREFIX).value)
        self._listed()

    def _look(self) -> None:
        """See what streams and what subscribers there are."""
        ready, gone = self._discovery.update()
        if self._routing.update(ready, gone):
            self._listed()
        self._routing.count_readers()
        self._pump.look()
        self._survey.look()
        if self._senders.look(self._discovery.inlets):
            self._reported(True)


def _configure_lsl(node: Node) -> None:
    session = node_parameters.declare(node, SESSION_ID)
    configure_lsl(session, node_parameters.declare(node, KNOWN_PEERS), SEARCH_PAUSE_S)


def _say_nothing(_sentence: str) -> None:
    pass
