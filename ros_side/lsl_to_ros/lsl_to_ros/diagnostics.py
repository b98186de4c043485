"""``/diagnostics``: one status a stream, once a second."""

from __future__ import annotations

from collections import deque
from time import monotonic
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from biosensor_common.naming import TopicName
from lsl_to_ros.bridge import Bridge

RATE_WINDOW_S = 10.0
# A regular stream is stale after so long without a sample.
STALE_AFTER_S = 5.0


class RateMeter:
    """Mean rate over the last seconds, from a count that only grows.

    Samples come in packets, so the time that counts is that of the newest sample,
    not that of the look: at 250 Hz in packets of 63 the difference is 2 percent.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()

    def rate(self, count: int, newest_s: float) -> float:
        """Take in the present count and the newest sample's time; return samples per second."""
        now = monotonic()
        if newest_s and (not self._points or count != self._points[-1].samples):
            self._points.append(_Point(now, count, newest_s))
        while self._points and now - self._points[0].seen_s > RATE_WINDOW_S:
            self._points.popleft()
        if len(self._points) < 2:
            return 0.0
        first, last = self._points[0], self._points[-1]
        elapsed = last.newest_s - first.newest_s
        return (last.samples - first.samples) / elapsed if elapsed > 0 else 0.0


class _Point(NamedTuple):
    seen_s: float
    samples: int
    newest_s: float


def stream_status(
    topic: TopicName, bridge: Bridge, rate: float, latency_s: float, correction_s: float | None
) -> DiagnosticStatus:
    """Describe one stream.

    Parameters
    ----------
    rate
        Measured, in Hz.
    latency_s
        Age of the newest sample.
    correction_s
        Offset between the sender's LSL clock and ours, None if not measured yet.
    """
    header = bridge.header
    level, message = _judge(topic, bridge, latency_s)
    readers = bridge.raw.get_subscription_count()
    readers += bridge.chunk.get_subscription_count() if bridge.chunk else 0
    values = {
        "topic": bridge.raw.topic_name,
        "chunk_topic": bridge.chunk.topic_name if bridge.chunk else "",
        "sensor": header.identity.sensor,
        "participant": header.identity.participant,
        "label": header.identity.label,
        "unit_of_measurement": ", ".join(dict.fromkeys(header.units)),
        "rate_measured": f"{rate:.2f}",
        "rate_nominal": f"{header.rate:.2f}",
        "received": str(bridge.received),
        "lost": _lost(bridge),
        "unfit": str(bridge.tally.unfit),
        "chunk_discarded": str(bridge.tally.discarded),
        "age_s": f"{latency_s:.3f}" if bridge.last_stamp else "",
        "clock_offset_s": "" if correction_s is None else f"{correction_s:.6f}",
        "subscribers": str(readers),
    }
    return DiagnosticStatus(
        level=level,
        name=f"lsl_to_ros: {bridge.raw.topic_name}",
        message=message,
        hardware_id=header.identity.unit,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _judge(topic: TopicName, bridge: Bridge, latency_s: float) -> tuple[bytes, str]:
    if topic.conflict:
        return DiagnosticStatus.ERROR, "two units of one sensor: give each a label in its settings"
    if topic.duplicate:
        return DiagnosticStatus.ERROR, "two streams claim to be this one"
    if bridge.header.rate > 0 and (not bridge.received or latency_s > STALE_AFTER_S):
        return DiagnosticStatus.STALE, "no samples"
    if bridge.tally.unfit:
        return DiagnosticStatus.WARN, "samples do not fit the message type"
    return DiagnosticStatus.OK, "streaming"


def _lost(bridge: Bridge) -> str:
    """By the agent's count, else an estimate, else the honest word."""
    losses = bridge.account.losses
    if losses is not None:
        return str(losses.total)
    if bridge.header.foreign and bridge.header.rate > 0:
        return f"about {bridge.tally.missing}"
    return "unknown"
