"""Builds the entries of ``/diagnostics``: one for the node, one for each topic.

Levels of a topic:

* ERROR: it cannot be sent, and why.
* STALE: a topic with a nominal rate, without a message for 5 s.
* WARN: in the last 10 s messages were lost on the way, or its stream was replaced; a clock
  is not synchronised; an integer was too large.
* OK: none of these.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus

from lsl_to_ros.accounts.status import StreamStatus
from lsl_to_ros.reports.diagnostics import STALE_AFTER_S, status
from lsl_to_ros.ros_to_lsl.bridge import Bridge
from lsl_to_ros.ros_to_lsl.pairs import too_many_pairs
from lsl_to_ros.ros_to_lsl.senders import NO_NUMBER_YET
from lsl_to_ros.ros_to_lsl.stamping import StampSource, doubt_of
from lsl_to_ros.ros_to_lsl.topic import Topic

PROGRAM = "ros_to_lsl"


@dataclass(slots=True)
class TopicStatus:
    """What the reports of one topic remember."""

    topic: Topic
    status: StreamStatus = field(default_factory=StreamStatus)


def node_status(
    topics: int, streams: int, clock_steps: int, left_out: Sequence[str]
) -> DiagnosticStatus:
    """Describe the node, and which topics ``all_small`` leaves out."""
    values = {
        "topics": str(topics),
        "streams": str(streams),
        "clock_steps": str(clock_steps),
        "left_out": ", ".join(left_out),
    }
    return status("node", DiagnosticStatus.OK, f"{streams} streams", values, program=PROGRAM)


def topic_status(each: TopicStatus) -> DiagnosticStatus:
    """Describe one topic."""
    topic = each.topic
    bridge = topic.bridge
    lost = bridge.losses.lost
    rate = each.status.meter.rate(bridge.received, bridge.newest_s)
    level, message = _judge(topic, each.status)
    values = {
        "type": topic.kind.name if topic.kind else bridge.request.type_name,
        "publishers": str(topic.publishers),
        "quality_of_service": str(topic.quality),
        "streams": ", ".join(bridge.streams),
        "received": str(bridge.received),
        "lost": "unknown" if lost is None else str(lost),
        "pushed": ", ".join(str(count) for count in bridge.streams.values()),
        "rate_measured": f"{rate:.2f}",
        "replaced": str(bridge.replaced),
        "stamped_by": _stamped_by(bridge),
        "stamps_moved": str(sum(each.moved for each in bridge.stampings)),
        **{f"clock_{source.value}": _clock(*told) for source, told in _clocks(bridge).items()},
        "is_received": str(bridge.is_received).lower(),
    }
    return status(topic.name, level, message, values, program=PROGRAM)


def topic_facts(topic: Topic) -> dict[str, object]:
    """Return what a heartbeat says of one topic."""
    bridge = topic.bridge
    wrong = {s.value: round(d.edge_s, 6) for s, d in bridge.doubtful_clocks.items()}
    clocks = {
        source.value: {"state": state, "edge_s": round(edge_s, 6)}
        for source, (state, edge_s) in _clocks(bridge).items()
        if math.isfinite(edge_s)
    }
    return {
        "received": bridge.received,
        "lost": bridge.losses.lost,
        "replaced": bridge.replaced,
        "stamped_by": {s.value: n for s, n in _stamped(bridge).items() if n},
        "wrong_clocks": wrong,
        "clocks": clocks,
        "left_out": bridge.left_out,
        "fault": bridge.fault,
    }


def _judge(topic: Topic, status: StreamStatus) -> tuple[bytes, str]:
    bridge = topic.bridge
    lost_lately, replaced_lately = status.recent(bridge.losses.lost or 0, bridge.replaced)
    silent_s = status.silence(bridge.received)
    if bridge.fault:
        return DiagnosticStatus.ERROR, bridge.fault
    if bridge.request.rate and silent_s > STALE_AFTER_S:
        return DiagnosticStatus.STALE, "no messages"
    warnings = [doubt_of(*each) for each in bridge.doubtful_clocks.items()]
    if lost_lately:
        warnings.append(f"{lost_lately} messages lost in the last 10 s")
    if replaced_lately:
        warnings.append("its sequences have changed, and so has the stream")
    if bridge.left_out:
        warnings.append(too_many_pairs())
    if bridge.is_empty:
        warnings.append(NO_NUMBER_YET)
    if warnings:
        return DiagnosticStatus.WARN, "; ".join(warnings)
    if bridge.received:
        return DiagnosticStatus.OK, "sending"
    return DiagnosticStatus.OK, "no message yet" if topic.publishers else "nobody publishes it"


def _stamped_by(bridge: Bridge) -> str:
    used = (f"{source.value} {count}" for source, count in _stamped(bridge).items() if count)
    return ", ".join(used)


def _stamped(bridge: Bridge) -> Mapping[StampSource, int]:
    """Return how many samples were stamped by which."""
    counts: Counter[StampSource] = Counter()
    for each in bridge.stampings:
        counts.update(each.sources)
    return counts


def _clocks(bridge: Bridge) -> Mapping[StampSource, tuple[str, float]]:
    """Return state and edge of each clock; of the parts of a topic, the one that is worst."""
    found: dict[StampSource, tuple[str, float]] = {}
    for stamping in bridge.stampings:
        for source, clock in stamping.clocks.items():
            told = clock.state.value, clock.bound_s
            known = found.get(source, told)
            found[source] = told if not abs(told[1]) <= abs(known[1]) else known
    return found


def _clock(state: str, edge_s: float) -> str:
    return state if math.isnan(edge_s) else f"{state}, {edge_s:.6f} s"
