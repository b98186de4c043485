"""Sends pairs of system and LSL time in the stream ``lsl_to_ros/events``.

Stamps of topics are system time, those of streams LSL time. With these pairs, a recording and a
bag of the same session can be put onto one time axis. Each sample is a
JSON object like those of the agent's events: ``event`` (``heartbeat``), ``lsl_time``, ``node``,
``use_sim_time``, and ``clock`` as in :mod:`biosensor_common.ros_clock`. Under ``use_sim_time``
the pairs are still of the system clock, to which the stamps of the topics then have no relation.
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections.abc import Callable

import pylsl
from rclpy.node import Node

from biosensor_common.errors import TransportError
from biosensor_common.lsl.outlet import LslOutlet
from biosensor_common.lsl_header import append_children, describe
from biosensor_common.naming import NODE, lsl_name, source_id
from biosensor_common.quantities import ChannelFormat, ContentType, MessageType, Unit
from biosensor_common.ros_clock import NS_PER_S, STEP_NS, ClockPair, measure_clock_pair
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.table import channels, hardware

CLOCK_PERIOD_S = 0.5
"""Period of the checks whether a pair is to be sent."""
HEARTBEAT_S = 10.0

EVENTS = hardware(
    "events",
    ContentType.MARKERS,
    channels(Unit.NONE, "event"),
    channel_format=ChannelFormat.STRING,
    message_type=MessageType.STRING,
)


class ClockPairs:
    """The node's own stream; a node that cannot offer one continues without.

    A pair is sent every ten seconds, when a receiver connects, and when the system clock has
    been set.

    Parameters
    ----------
    node
        Its name and domain distinguish the nodes of one computer.
    warn
        Called with a sentence if the stream cannot be offered.
    """

    def __init__(self, node: Node, warn: Callable[[str], None]) -> None:
        self._node = node
        self._outlet = _outlet(node, warn)
        self._told: ClockPair | None = None
        self._due_s = -math.inf
        self._had_receivers = False

    def look(self) -> None:
        """Send a pair if one is scheduled; call it a few times a second."""
        if self._outlet is None:
            return
        pair = measure_clock_pair(time.time_ns, pylsl.local_clock)
        has_receivers = self._outlet.have_consumers()
        has_come = has_receivers and not self._had_receivers
        self._had_receivers = has_receivers
        if has_come or pair.lsl_s >= self._due_s or self._was_set(pair):
            self._tell(self._outlet, pair)

    def close(self) -> None:
        """End the stream."""
        self._outlet = None

    def _was_set(self, pair: ClockPair) -> bool:
        told = self._told
        if told is None:
            return False
        return abs(_offset_ns(pair) - _offset_ns(told)) > STEP_NS

    def _tell(self, outlet: LslOutlet, pair: ClockPair) -> None:
        self._told, self._due_s = pair, pair.lsl_s + HEARTBEAT_S
        event = {
            "event": "heartbeat",
            "node": self._node.get_fully_qualified_name(),
            "use_sim_time": self._node.get_clock().ros_time_is_active,
            **pair.as_facts(),
            "lsl_time": pair.lsl_s,
        }
        outlet.push_sample([json.dumps(event, separators=(",", ":"))], pair.lsl_s)


def _offset_ns(pair: ClockPair) -> int:
    return pair.unix_ns - round(pair.lsl_s * NS_PER_S)


def _outlet(node: Node, warn: Callable[[str], None]) -> LslOutlet | None:
    try:
        return events_outlet(node, "lsl_to_ros")
    except (RuntimeError, TransportError) as error:
        warn(f"recordings will not contain this computer's time: LSL offers no stream ({error})")
        return None


def events_outlet(node: Node, model: str) -> LslOutlet:
    """Offer a node's own stream of events; *model* is the program's name.

    Raises
    ------
    RuntimeError
        pylsl's, if LSL offers no stream.
    TransportError
        ``EXHAUSTED``, if the process may open no more files.
    """
    identity = DeviceIdentity(NODE, unit_of(socket.gethostname(), node))
    info = pylsl.StreamInfo(
        lsl_name(identity, EVENTS.data_name),
        EVENTS.content_type.value,
        len(EVENTS.channels),
        0.0,
        EVENTS.format.value,
        source_id(identity, EVENTS.data_name),
    )
    append_children(info.desc(), describe(EVENTS, identity, DeviceInfo(model=model)))
    return LslOutlet(info)


def unit_of(hostname: str, node: Node) -> str:
    """Return a unique unit for a node: its computer, and its name and domain if not the default."""
    name = node.get_fully_qualified_name().strip("/").replace("/", "_")
    domain = node.context.get_domain_id()
    other_name = f"_{name}" if name != NODE else ""
    return f"{hostname}{other_name}" + (f"_domain{domain}" if domain else "")
