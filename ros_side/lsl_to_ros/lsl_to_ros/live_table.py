"""Shows a live table of all biosensor topics, as a subscriber sees them.

``python -m lsl_to_ros.live_table [--seconds N] [--expect FILE]``. FILE is JSON:
topic names with an empty text where data is expected, else the reason why not.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from biosensor_common.open_files import raise_limit
from biosensor_common.quantities import MessageType
from biosensor_common.terminal import columns
from lsl_to_ros.accounts.rates import RateMeter
from lsl_to_ros.fitting import fitted, widths
from lsl_to_ros.taking import MessageInfo, RosMessage, TakenElsewhere, Taker, nobody
from lsl_to_ros.topics.messages import CLASSES

FIRST_SAMPLE_TIMEOUT_S = 30.0
REFRESH_S = 1.0
QUEUE_DEPTH = 1000
_CLEAR = "\x1b[H\x1b[J"
_HEADINGS = ("topic", "type", "Hz", "nominal", "last value", "age s", "lost")


@dataclass(slots=True)
class Row:
    """What was received on one topic.

    Attributes
    ----------
    facts
        The values of the topic's status in ``/diagnostics``.
    """

    topic: str
    message_type: MessageType
    received: int = 0
    newest: float = 0.0
    last: Any = None
    facts: dict[str, str] = field(default_factory=dict[str, str])
    meter: RateMeter = field(default_factory=RateMeter)

    def cells(self) -> tuple[str, ...]:
        """Text of each column."""
        age = f"{monotonic() - self.newest:.1f}" if self.received else "-"
        nominal = float(self.facts.get("rate_nominal", 0))
        if self.topic.endswith("_chunk") and self.received:
            nominal /= self.last.layout.dim[0].size
        return (
            self.topic,
            self.message_type.rpartition("/")[2],
            f"{self.meter.rate(self.received, self.newest):.2f}",
            f"{nominal:.2f}" if nominal else "irregular",
            _shown(self.last, self.facts.get("unit_of_measurement", "")),
            age,
            self.facts.get("lost", "unknown"),
        )


class LiveTable(Node):
    """Subscribes to every topic that ``lsl_to_ros`` publishes."""

    def __init__(self) -> None:
        super().__init__("biosensor_live_table")
        # An executor of rclpy is too slow for so many topics: it would show wrong rates.
        self._taker = Taker(self, self._fail)
        self._group = TakenElsewhere()
        self.rows: dict[str, Row] = {}
        self.first_sample: float | None = None
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_facts, 10)
        # By the node's own clock it would rest for as long as that is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.5, self._subscribe, clock=steady)

    def _subscribe(self) -> None:
        types = {kind.value: kind for kind in MessageType}
        for topic, kinds in self.get_topic_names_and_types():
            known = topic in self.rows or "/biosensors/" not in topic
            if known or len(kinds) != 1 or kinds[0] not in types:
                continue
            kind = types[kinds[0]]
            self.rows[topic] = row = Row(topic, kind)
            subscription = self.create_subscription(
                CLASSES[kind], topic, nobody, QUEUE_DEPTH, callback_group=self._group
            )
            self._taker.add(subscription, partial(self._take, row))

    def stop(self) -> None:
        """Take what has come, and nothing more."""
        self._taker.stop()

    def _fail(self, subscription: Subscription, error: Exception) -> None:
        self.get_logger().error(f"{subscription.topic_name}: {error}")

    def _take(self, row: Row, message: RosMessage, info: MessageInfo) -> None:
        del info
        row.received += 1
        row.newest = monotonic()
        row.last = message
        if self.first_sample is None:
            self.first_sample = row.newest

    def _take_facts(self, array: DiagnosticArray) -> None:
        for status in array.status:
            facts = {item.key: item.value for item in status.values}
            for name in (facts.get("topic"), facts.get("chunk_topic")):
                row = self.rows.get(name or "")
                if row is not None:
                    row.facts = facts


def _shown(message: Any, unit: str) -> str:  # noqa: ANN401 - any message
    """Last value with its unit; of several the first three, of a chunk its size."""
    if message is None:
        return "-"
    data = getattr(message, "data", None)
    if data is None:
        return type(message).__name__
    if not hasattr(message, "layout"):
        return f"{data:.5g} {unit}" if isinstance(data, float) else f"{data} {unit}"
    if len(message.layout.dim) > 1:
        return " x ".join(str(dimension.size) for dimension in message.layout.dim)
    shown = " ".join(f"{value:.3g}" for value in data[:3])
    return f"{shown} {'...' if len(data) > 3 else unit}"


def render(rows: Sequence[Row], width: int | None = None) -> str:
    """Format the table, a line a topic; a width is that of the terminal to fit in."""
    cells = [_HEADINGS, *(row.cells() for row in sorted(rows, key=lambda row: row.topic))]
    lines = fitted(cells, width)
    sizes = widths(lines)
    return "\n".join(
        "  ".join(text.ljust(size) for text, size in zip(line, sizes, strict=True)).rstrip()
        for line in lines
    )


def summary(rows: dict[str, Row], expected: dict[str, str]) -> tuple[str, bool]:
    """Say which topics received nothing and whether that was to be expected."""
    lines: list[str] = []
    complete = True
    for topic, reason in expected.items():
        if topic in rows and rows[topic].received:
            continue
        complete = complete and bool(reason)
        lines.append(f"{topic}: {f'not expected, {reason}' if reason else 'MISSING'}")
    return "\n".join(lines), complete


def main() -> None:
    """Show the table until SIGINT or for a time; exit code 1 if an expected topic had no data."""
    raise_limit()
    parser = argparse.ArgumentParser(description="A live table of all biosensor topics.")
    parser.add_argument("--seconds", type=float, help="counted from the first sample")
    parser.add_argument("--expect", type=Path, help="JSON file of topics to wait for")
    options = parser.parse_args()
    expected: dict[str, str] = json.loads(options.expect.read_text()) if options.expect else {}
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        stopping.set()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
    node = LiveTable()
    try:
        _spin(node, options.seconds, stopping)
    finally:
        node.stop()
        node.destroy_node()
        rclpy.shutdown()
    raise SystemExit(_conclude(node, options.seconds, expected))


def _spin(node: LiveTable, seconds: float | None, stopping: threading.Event) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    started = shown = monotonic()
    while not stopping.is_set():
        executor.spin_once(timeout_sec=0.1)
        now = monotonic()
        if now >= _end(node.first_sample, started, seconds):
            break
        if now - shown >= REFRESH_S:
            shown = now
            # Rendered in any case: the rates are measured from one look to the next.
            table = render(list(node.rows.values()), columns(sys.stdout))
            if sys.stdout.isatty():
                sys.stdout.write(f"{_CLEAR}{table}\n")
                sys.stdout.flush()
    executor.shutdown()


def _end(first_sample: float | None, started: float, seconds: float | None) -> float:
    if first_sample is None:
        return started + FIRST_SAMPLE_TIMEOUT_S
    return float("inf") if seconds is None else first_sample + seconds


def _conclude(node: LiveTable, seconds: float | None, expected: dict[str, str]) -> int:
    sys.stdout.write(render(list(node.rows.values()), columns(sys.stdout)) + "\n")
    if node.first_sample is None:
        sys.stdout.write(f"nothing received within {FIRST_SAMPLE_TIMEOUT_S:.0f} s\n")
        return 1
    missing, complete = summary(node.rows, expected)
    if missing:
        sys.stdout.write(missing + "\n")
    # Without a time to fill up in, nothing can be said to be missing.
    return 0 if complete or seconds is None else 1


if __name__ == "__main__":
    main()
