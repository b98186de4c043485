"""Builds ``/diagnostics``: the status of each stream, each device and the node.

Levels of a stream:

* ERROR: errors of :class:`biosensor_common.refusal.Refusal`: two units or two streams claim its
  name; another sender with the same source_id is left out; another node publishes it, too, for
  longer than DDS remembers a node that was killed.
* STALE: a regular stream, without a sample for 5 s, or three periods if that is longer; any
  stream of a computer with an agent, from which nothing at all has come for 1.5 s.
* WARN: its sensor is paused or not connected; other data was left out, duplicated, renamed or
  guessed, now or in the last 10 s; in the last 10 s samples were lost, or the measured rate is more
  than 10 % off; a topic is published faster than subscribers receive it.
* OK: none of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node

from biosensor_common import process_limits
from biosensor_common.naming import AGENT, TopicName
from biosensor_common.refusal import Level, Refusal, Refusals, Refused
from biosensor_common.stream_header import stale_after_s
from lsl_to_ros.statistics.losses import Delays, NodeCounters, can_estimate_losses
from lsl_to_ros.statistics.status import RATE_WINDOW_S, LoadFacts, StreamStatus
from lsl_to_ros.topics.bridge import Bridge

_MOST_NAMED = 5
_RELIEF = (
    "read fast topics as _chunk or _stamped, switch streams off (Sensor_Enable), or divide the "
    "streams among nodes on several computers (stream_predicate)"
)


def overload(load: LoadFacts) -> str:
    """Return a sentence about the node's overload; empty if it keeps up."""
    share = "" if load.share is None else f"{100 * load.share:.0f} % of a core"
    if load.is_busy:
        waited = f", and data has waited {load.age_s:.1f} s in it" if load.age_s >= 0.1 else ""
        return f"the node needs {share}{waited}: {_RELIEF}"
    if load.is_late:
        gets = f", which gets {share}" if share else ""
        return (
            f"data has waited {load.age_s:.1f} s in the node{gets}: other programs keep this "
            f"computer busy; end some, or {_RELIEF}"
        )
    return ""


def crowded_out(streams: Sequence[str]) -> str:
    """Return a sentence about streams beyond the limit of open files; empty if there are none."""
    if not streams:
        return ""
    named = ", ".join(streams[:_MOST_NAMED]) + ", ..." * (len(streams) > _MOST_NAMED)
    return str(process_limits.exhausted(f"{len(streams)} streams are left out ({named})"))


def too_fast(rate: float, topics: Sequence[str], best_effort: Sequence[str]) -> str:
    """Return a sentence about a topic that is published faster than subscribers receive it.

    Parameters
    ----------
    rate
        Messages per second.
    topics
        Topics with the same samples in fewer messages.
    best_effort
        Nodes that read with best effort, to which DDS does not resend.
    """
    instead = f"; read {' or '.join(topics)} instead" if topics else ""
    unsafe = f"; {', '.join(best_effort)}: best effort, nothing is retransmitted" * bool(
        best_effort
    )
    return (
        f"{rate:.0f} messages per second, more than a Python subscriber can handle, and no "
        f"counter of the node shows what its queue drops{instead}{unsafe}"
    )


def not_taken(messages: int) -> str:
    """Return a sentence about a subscriber that does not keep up."""
    return (
        f"a subscriber hangs or is too slow: {messages} messages of a backlog in the last 10 s "
        "were sent before it had taken the earlier ones, and it may lose some"
    )


RATE_TOLERANCE = 0.1
# Stamps that differ more from now are not on the LSL clock; the agent refuses them at 30 s.
CLOCK_TOLERANCE_S = 30.0
# If a clock is unknown for longer, it cannot be measured, because UDP is blocked.
CLOCK_PATIENCE_S = 10.0

# How long DDS keeps the publishers of a node that was killed.
LEASE_S = 25.0

PROGRAM = "lsl_to_ros"
PAUSED = "paused"
"""State of a device whose participant has withdrawn."""


@dataclass(frozen=True, slots=True)
class StreamFacts:
    """Facts of one stream for a report."""

    topic: TopicName
    bridge: Bridge
    age_s: float  # Age of the newest sample, on this machine's LSL clock.
    rate: float  # Measured rate in Hz.
    # correction_s, spread_s: offset between the sender's LSL clock and ours, and its recent spread;
    # None before the first measurement.
    correction_s: float | None
    spread_s: float
    delays: Delays  # Delays from stamp to receipt of the samples since the last report.
    lost_lately: int  # Samples lost in the last 10 s.
    refused: Sequence[Refused]  # Present reports of data that was not published unchanged.
    silent_s: float  # Seconds since a report first saw the newest sample.
    attached_s: float  # How long the node has had this stream.
    # Messages of a backlog that were published in the last 10 s before the subscribers had received
    # the previous ones.
    not_taken_lately: int
    published_hz: float  # Messages per second of the first topic, over the last 10 s.
    is_fast: bool  # Whether that is faster than a usual subscriber receives them.
    waited_s: float  # Longest time that samples have waited in the node since the last report.
    trouble: str = ""  # Sentence about the sending computer if it is silent, else empty.
    # Nodes that read the first topic with best effort; determined only if it is fast.
    best_effort: Sequence[str] = ()
    # Computers of other senders with the same source_id that are left out.
    twins: Sequence[str] = ()
    # Computers of all senders with the same source_id that have a topic each.
    senders: Sequence[str] = ()
    # For how many seconds another node has published its first topic, too; 0 if none does.
    doubled_s: float = 0.0


def stream_facts(
    topic: TopicName,
    bridge: Bridge,
    status: StreamStatus,
    correction_s: float | None,
    spread_s: float,
    now_s: float,
    trouble: str = "",
) -> StreamFacts:
    """Collect the facts of one stream; *now_s* is this machine's LSL clock."""
    counters: NodeCounters = bridge.counters
    lost = counters.lost(can_estimate=can_estimate_losses(bridge.header))
    first = bridge.outputs.of_samples[0].publisher
    not_taken_lately = status.publishing.look(first.lane.sent, first.lane.not_taken)
    lost_lately, _ = status.recent(max(lost.count, 0), 0)
    return StreamFacts(
        topic=topic,
        bridge=bridge,
        age_s=bridge.age_s(now_s),
        rate=status.meter.rate(counters.received, bridge.last_stamp, bridge.header.rate),
        correction_s=correction_s,
        spread_s=spread_s,
        delays=counters.take_delays(),
        lost_lately=lost_lately,
        refused=counters.refusals.present,
        silent_s=status.silence(counters.received),
        attached_s=monotonic() - status.begun_s,
        not_taken_lately=not_taken_lately,
        published_hz=status.publishing.rate,
        is_fast=status.publishing.is_fast,
        waited_s=status.take_oldest(),
        trouble=trouble,
    )


def stream_status(facts: StreamFacts) -> DiagnosticStatus:
    """Make the status of one stream."""
    bridge, header = facts.bridge, facts.bridge.header
    level, message = judge(facts)
    replay = header.replay
    if replay is not None:
        message = f"{message}; a replay of {replay.title}"
    raw, chunk = bridge.outputs.of_samples[0].publisher, bridge.outputs.chunk
    counters = bridge.counters
    lost = counters.lost(can_estimate=can_estimate_losses(header))
    values = {
        "topic": raw.name,
        "chunk_topic": chunk.publisher.name if chunk else "",
        "sensor": header.identity.sensor,
        "participant": header.identity.participant,
        "label": header.identity.label,
        "replay_of": replay.file if replay else "",
        "unit_of_measurement": ", ".join(dict.fromkeys(header.units)),
        "rate_measured": f"{facts.rate:.2f}",
        "rate_nominal": f"{header.rate:.2f}",
        "received": str(counters.received),
        "lost": str(lost),
        "sent_before": _count(counters.comparison.before),
        "unfit": str(counters.unfit),
        "unstamped": str(counters.unstamped),
        "chunk_discarded": str(counters.discarded),
        "refusals": words_of(counters.refusals),
        "published": str(raw.lane.sent),
        "waiting": str(bridge.waiting),
        "queue_age_s": f"{facts.waited_s:.3f}",
        "unsent": str(sum(publisher.lane.unsent for publisher in bridge.outputs.publishers)),
        "not_taken": str(raw.lane.not_taken),
        "age_s": f"{facts.age_s:.3f}" if bridge.last_stamp else "",
        "latency_mean_s": _seconds(facts.delays.mean),
        "latency_max_s": _seconds(facts.delays.longest if facts.delays.count else None),
        "clock_offset_s": _seconds(facts.correction_s),
        "clock_offset_spread_s": _seconds(
            facts.spread_s if facts.correction_s is not None else None
        ),
        "subscribers": str(bridge.readers),
    }
    return status(f"{raw.name}", level, message, values, header.identity.unit)


def status(
    name: str,
    level: bytes,
    message: str,
    values: dict[str, str],
    hardware_id: str = "",
    program: str = PROGRAM,
) -> DiagnosticStatus:
    """Make an entry of ``/diagnostics``."""
    return DiagnosticStatus(
        level=level,
        name=f"{program}: {name}",
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def named_by(node: Node, statuses: Sequence[DiagnosticStatus]) -> None:
    """Give entries the name of their node, so that two nodes never replace each other's."""
    program = node.get_fully_qualified_name().lstrip("/")
    for each in statuses:
        each.name = f"{program}: {each.name.partition(': ')[2]}"


def words_of(refusals: Refusals) -> str:
    """Return each kind of refusal with its count since the start, as text."""
    return ", ".join(f"{each.what.word} {each.count}" for each in refusals.all)


def judge(facts: StreamFacts) -> tuple[bytes, str]:
    """Return level and reason; the module's docstring has the thresholds."""
    bridge = facts.bridge
    refused = sorted(_refused(facts), key=lambda each: -each[0])
    errors = [sentence for level, sentence in refused if level is Level.ERROR]
    if errors:
        return DiagnosticStatus.ERROR, errors[0]
    if facts.trouble:
        return DiagnosticStatus.STALE, facts.trouble
    # Not by the age of samples: they may keep coming with old stamps, or stamps of another clock.
    is_silent = facts.silent_s > stale_after_s(bridge.header.rate) or not bridge.last_stamp
    away = away_sentence(bridge.counters.said.away)
    if bridge.header.rate > 0 and is_silent:
        return DiagnosticStatus.STALE, f"no samples: {away}" if away else "no samples"
    others = [reason for is_so, reason in _warnings(facts) if is_so]
    # Only the first measured warning, because several often have one cause; but all refusals.
    said = [*([away] if away else []), *bridge.counters.said.refused]
    warnings = [*said, *(sentence for _, sentence in refused), *others[:1]]
    if warnings:
        return DiagnosticStatus.WARN, "; ".join(warnings)
    return DiagnosticStatus.OK, "streaming" if bridge.last_stamp else "no sample yet"


def away_sentence(state: str) -> str:
    """Return why a device does not send, by its state of the agent; empty if it sends."""
    if not state:
        return ""
    if state == PAUSED:
        return "its sensor is paused, and none of its data is sent"
    return f"its sensor is not connected ({state}), and the last data is old"


def _refused(facts: StreamFacts) -> list[tuple[Level, str]]:
    """Return level and sentence about data of a stream left out, duplicated or guessed."""
    bridge = facts.bridge
    is_agent = bridge.header.identity.sensor == AGENT
    is_foreign_clock = _has_foreign_clock(facts) and not bridge.has_unix_stamps
    is_unknown = facts.correction_s is None and facts.attached_s > CLOCK_PATIENCE_S
    twins, senders = ", ".join(facts.twins), ", ".join(dict.fromkeys(facts.senders))
    hosts = {Refusal.SAME_SOURCE: twins, Refusal.SECOND_SENDER: senders}
    found = {
        Refusal.TWO_UNITS: facts.topic.conflict and not is_agent,
        Refusal.TWO_STREAMS: facts.topic.duplicate,
        Refusal.SAME_SOURCE: bool(facts.twins),
        Refusal.DOUBLED: facts.doubled_s > LEASE_S,
        Refusal.MAYBE_DOUBLED: 0 < facts.doubled_s <= LEASE_S,
        Refusal.SECOND_SENDER: len(facts.senders) > 1,
        Refusal.UNIX_STAMPS: bridge.has_unix_stamps,
        Refusal.FOREIGN_STAMPS: is_foreign_clock,
        Refusal.UNKNOWN_CLOCK: is_unknown,
    }
    told = [
        (what.level, what.message(hosts=hosts.get(what, ""), senders=len(facts.senders)))
        for what, is_so in found.items()
        if is_so
    ]
    return [*told, *((each.what.level, each.sentence_about) for each in facts.refused)]


def _warnings(facts: StreamFacts) -> list[tuple[bool, str]]:
    nominal = facts.bridge.header.rate
    is_measured = nominal > 0 and facts.rate > 0 and facts.attached_s > RATE_WINDOW_S
    is_off = is_measured and abs(facts.rate / nominal - 1) > RATE_TOLERANCE
    return [
        (facts.lost_lately > 0, f"{facts.lost_lately} samples lost in the last 10 s"),
        (facts.not_taken_lately > 0, not_taken(facts.not_taken_lately)),
        (facts.is_fast, too_fast(facts.published_hz, _slower(facts.bridge), facts.best_effort)),
        (is_off, f"{facts.rate:.2f} Hz instead of {nominal:.2f} Hz"),
    ]


def _slower(bridge: Bridge) -> list[str]:
    """Return the topics that have several samples per message."""
    chunk = [bridge.outputs.chunk.publisher] if bridge.outputs.chunk else []
    several = [*chunk, *(writer.publisher for writer in bridge.outputs.timed)]
    return [each.name for each in several if each.name.endswith(("_chunk", "_stamped"))]


def _has_foreign_clock(facts: StreamFacts) -> bool:
    mean = facts.delays.mean
    return mean is not None and abs(mean) > CLOCK_TOLERANCE_S


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}"
