"""Builds the entries of ``/diagnostics``: one for the node, one for each topic.

Levels of a topic:

* ERROR: it cannot be sent; the message says why.
* STALE: a topic with a nominal rate, without a message for 5 s.
* WARN: some of it is not sent unchanged, now or in the last 10 s; a clock is not synchronised.
  :class:`biosensor_common.refusal.Refusal` lists all cases.
* OK: none of these.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.refusal import Level, Refusals, Refused
from biosensor_common.stream_header import stale_after_s
from lsl_to_ros.reports.diagnostics import status, words_of
from lsl_to_ros.ros_to_lsl.graph import Topic
from lsl_to_ros.ros_to_lsl.stamps import StampSource
from lsl_to_ros.ros_to_lsl.topic_bridge import Bridge

PROGRAM = "ros_to_lsl"


def node_status(
    topics: int, streams: int, clock_steps: int, left_out: Sequence[str], refusals: Refusals
) -> DiagnosticStatus:
    """Make the status of the node, with the topics that ``all_small`` leaves out."""
    present = refusals.present
    values = {
        "topics": str(topics),
        "streams": str(streams),
        "clock_steps": str(clock_steps),
        "left_out": ", ".join(left_out),
        "refusals": words_of(refusals),
    }
    message = "; ".join(each.sentence_about for each in present) or f"{streams} streams"
    return status("node", _level(present), message, values, program=PROGRAM)


def topic_status(topic: Topic) -> DiagnosticStatus:
    """Make the status of one topic."""
    bridge = topic.bridge
    lost = bridge.losses.lost
    rate = topic.status.meter.rate(bridge.received, bridge.newest_s, bridge.request.rate)
    level, message = _judge(topic)
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
        "refusals": words_of(bridge.refusals),
    }
    return status(topic.name, level, message, values, program=PROGRAM)


def topic_facts(topic: Topic) -> dict[str, object]:
    """Return the facts of one topic for a heartbeat."""
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


def _judge(topic: Topic) -> tuple[bytes, str]:
    bridge = topic.bridge
    silent_s = topic.status.silence(bridge.received)
    bridge.judge_clocks()
    present = bridge.refusals.present
    errors = [each.sentence for each in present if each.what.level is Level.ERROR]
    if errors:
        return DiagnosticStatus.ERROR, errors[0]
    if bridge.request.rate and silent_s > stale_after_s(bridge.request.rate):
        return DiagnosticStatus.STALE, "no messages"
    if present:
        return DiagnosticStatus.WARN, "; ".join(each.sentence for each in present)
    if bridge.received:
        return DiagnosticStatus.OK, "sending"
    return DiagnosticStatus.OK, "no message yet" if topic.publishers else "nobody publishes it yet"


def _level(present: Sequence[Refused]) -> bytes:
    return bytes([max((each.what.level for each in present), default=0)])


def _stamped_by(bridge: Bridge) -> str:
    used = (f"{source.value} {count}" for source, count in _stamped(bridge).items() if count)
    return ", ".join(used)


def _stamped(bridge: Bridge) -> Mapping[StampSource, int]:
    """Return the number of samples per source of stamps."""
    counts: Counter[StampSource] = Counter()
    for each in bridge.stampings:
        counts.update(each.sources)
    return counts


def _clocks(bridge: Bridge) -> Mapping[StampSource, tuple[str, float]]:
    """Return state and edge of each clock; for a topic with parts, the worst of them."""
    found: dict[StampSource, tuple[str, float]] = {}
    for stamping in bridge.stampings:
        for source, clock in stamping.clocks.items():
            told = clock.state.value, clock.bound_s
            known = found.get(source, told)
            found[source] = told if not abs(told[1]) <= abs(known[1]) else known
    return found


def _clock(state: str, edge_s: float) -> str:
    return state if math.isnan(edge_s) else f"{state}, {edge_s:.6f} s"
