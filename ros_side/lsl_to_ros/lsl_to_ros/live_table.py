"""Shows a live table of all biosensor topics, as subscribers receive them.

``python -m lsl_to_ros.live_table [--seconds N] [--expect FILE]``. FILE is JSON:
topic names with an empty text where data is expected, else the reason why not.

Exit codes: 0 if all expected topics had data, 1 if one had none, 3 if the computer is too busy and
topics are still missing.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from biosensor_common.process_limits import raise_limit
from biosensor_common.quantities import MessageType
from biosensor_common.terminal import columns, shortened
from lsl_to_ros.reports.reporter import COMPUTER_BUSY
from lsl_to_ros.ros_environment import ensure_log_folder
from lsl_to_ros.statistics.status import RateMeter
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage, TakenElsewhere, Taker, nobody
from lsl_to_ros.topics.outputs import CLASSES

FIRST_SAMPLE_TIMEOUT_S = 30.0
MOST_TIMES = 3
"""Largest factor by which the time to wait is extended on a busy computer."""
PATIENCE_S, BUSY_PATIENCE_S = 5.0, 30.0
"""Longest time from one late topic to the next; a refused agent tries again within 30 s."""
BUSY_SHARE = 0.5
"""Share of its runnable time that this process had to wait for a processor."""
BUSY_LOAD = 3.0
"""Runnable programs per processor; used where the system does not report the share."""


@dataclass(slots=True)
class Waiting:
    """Progress of waiting for topics.

    Times are on one monotonic clock, in seconds.
    """

    expected: Collection[str]  # Topics that must have data.
    started_s: float
    asked_s: float | None  # How long to wait after the first sample; None for no limit.
    is_busy: bool = False  # Whether other programs kept the computer busy.
    is_cut_short: bool = False  # Whether it was stopped before the time was over.
    _came_s: dict[str, float] = field(default_factory=dict[str, float])

    def came(self, topic: str, now_s: float) -> None:
        """Record the first sample of a topic."""
        self._came_s.setdefault(topic, now_s)

    @property
    def has_begun(self) -> bool:
        """Whether any sample was received."""
        return bool(self._came_s)

    def has(self, topic: str) -> bool:
        """Whether a topic had data."""
        return topic in self._came_s

    @property
    def outstanding(self) -> list[str]:
        """The expected topics without data."""
        return [topic for topic in self.expected if topic not in self._came_s]

    @property
    def first_limit_s(self) -> float:
        """Time limit for the first sample of any topic."""
        return FIRST_SAMPLE_TIMEOUT_S * (MOST_TIMES if self.is_busy else 1)

    @property
    def end_s(self) -> float:
        """End of the waiting, as far as is known now."""
        if not self._came_s:
            return self.started_s + self.first_limit_s
        if self.asked_s is None:
            return inf
        # A copy, because another thread may add topics.
        came_s = list(self._came_s.values())
        first_s, newest_s = min(came_s), max(came_s)
        if not self.outstanding:
            return first_s + self.asked_s
        patience_s = BUSY_PATIENCE_S if self.is_busy else PATIENCE_S
        later_s = min(newest_s + patience_s, first_s + MOST_TIMES * self.asked_s)
        return max(first_s + self.asked_s, later_s)


class ProcessorWait:
    """Measures how long this process has waited for a processor since its start."""

    def is_long(self) -> bool:
        """Whether it waits for most of its runnable time."""
        share = waiting_share(_schedules())
        if share is None:
            return os.getloadavg()[0] > BUSY_LOAD * (os.cpu_count() or 1)
        return share > BUSY_SHARE


def waiting_share(schedules: Iterable[str]) -> float | None:
    """Return the share of time that threads waited for a processor; None if it is not known.

    Parameters
    ----------
    schedules
        Linux's ``schedstat`` of each thread: nanoseconds of running and of waiting.
    """
    ran = waited = 0
    for schedule in schedules:
        own = schedule.split()
        ran, waited = ran + int(own[0]), waited + int(own[1])
    return waited / (ran + waited) if ran else None


def _schedules() -> Iterable[str]:
    for each in Path("/proc/self/task").glob("*/schedstat"):
        try:
            yield each.read_text(encoding="ascii")
        except OSError:
            # nothing is dropped: the thread has ended
            continue  # nothing is dropped: as above


REFRESH_S = 1.0
QUEUE_DEPTH = 1000
WIDTH = 100
"""Width without a terminal: in a pipe or a log."""
EXIT_MISSING, EXIT_BUSY = 1, 3
_CLEAR = "\x1b[H\x1b[J"
_HEADINGS = ("topic", "type", "Hz", "nominal", "last value", "age s", "lost")
Line = tuple[str, ...]
_GAP = 2
_TOPIC, _VALUE = 0, 4
_PREFIX = "/biosensors/"
_LEAST_VALUE, _LEAST_TOPIC, _SHORTEST_VALUE = 12, 20, 8


@dataclass(slots=True)
class Row:
    """The data received on one topic."""

    topic: str
    message_type: MessageType
    received: int = 0
    newest: float = 0.0
    last: Any = None
    # The values of the topic's status in `/diagnostics`.
    facts: dict[str, str] = field(default_factory=dict[str, str])
    meter: RateMeter = field(default_factory=RateMeter)

    def cells(self) -> tuple[str, ...]:
        """Return the text of each column."""
        age = f"{monotonic() - self.newest:.1f}" if self.received else "-"
        nominal = float(self.facts.get("rate_nominal", 0))
        if self.topic.endswith("_chunk") and self.received:
            nominal /= self.last.layout.dim[0].size
        return (
            self.topic,
            self.message_type.rpartition("/")[2],
            f"{self.meter.rate(self.received, self.newest, nominal):.2f}",
            f"{nominal:.2f}" if nominal else "irregular",
            _shown(self.last, self.facts.get("unit_of_measurement", "")),
            age,
            self.facts.get("lost", "unknown"),
        )


class LiveTable(Node):
    """Subscribes to every topic that ``lsl_to_ros`` publishes."""

    def __init__(self, waiting: Waiting) -> None:
        super().__init__("biosensor_live_table")
        self._waiting = waiting
        # rclpy's executor is too slow for so many topics and would show wrong rates.
        self._taker = Taker(self, self._fail)
        self._group = TakenElsewhere()
        self.rows: dict[str, Row] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_facts, 10)
        # With the node's own clock the timer would stop for as long as that is set back.
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
                CLASSES[kind], topic, nobody, self._profile(topic), callback_group=self._group
            )
            self._taker.add(subscription, partial(self._take, row))

    def _profile(self, topic: str) -> QoSProfile:
        # Transient local shows states published before, but does not match volatile publishers.
        offers = [each.qos_profile for each in self.get_publishers_info_by_topic(topic)]
        is_latched = offers and all(
            each.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in offers
        )
        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=QUEUE_DEPTH, durability=durability)

    def stop(self) -> None:
        """Take the messages received so far, and stop."""
        self._taker.stop()

    def _fail(self, subscription: Subscription, error: Exception) -> None:
        self.get_logger().error(f"{subscription.topic_name}: {error}")

    def _take(self, row: Row, message: RosMessage, info: MessageInfo) -> None:
        del info
        row.received += 1
        row.newest = monotonic()
        row.last = message
        if row.received == 1:
            self._waiting.came(row.topic, row.newest)

    def _take_facts(self, array: DiagnosticArray) -> None:
        for status in array.status:
            facts = {item.key: item.value for item in status.values}
            self._waiting.is_busy |= facts.get(COMPUTER_BUSY) == "true"
            for name in (facts.get("topic"), facts.get("chunk_topic")):
                row = self.rows.get(name or "")
                if row is not None:
                    row.facts = facts


def _shown(message: Any, unit: str) -> str:  # noqa: ANN401 - any message
    """Format the last value with its unit; the first three of several; the size of a chunk."""
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
    """Format the table, one line per topic, to fit the width of the terminal."""
    cells = [_HEADINGS, *(row.cells() for row in sorted(rows, key=lambda row: row.topic))]
    lines = fitted(cells, width or WIDTH)
    sizes = widths(lines)
    return "\n".join(
        "  ".join(text.ljust(size) for text, size in zip(line, sizes, strict=True)).rstrip()
        for line in lines
    )


def top(table: str, height: int) -> str:
    """Return as many lines of a table as fit into a terminal, headings first; 0 for any height."""
    lines = table.splitlines()
    # The last line of a terminal is that of the cursor.
    if not height or len(lines) < height:
        return table
    kept = lines[: max(1, height - 2)]
    left_out = len(lines) - len(kept)
    return "\n".join([*kept, f"... and {left_out} more topics: in a higher window, or at the end"])


def summary(waiting: Waiting, reasons: Mapping[str, str]) -> tuple[Sequence[str], int]:
    """Return lines about the topics without data, with reasons, and the exit code.

    Parameters
    ----------
    reasons
        Reason why a topic was not expected, by topic; empty if it was.
    """
    lines = [
        f"{topic}: not expected, {reason}"
        for topic, reason in reasons.items()
        if reason and not waiting.has(topic)
    ]
    outstanding = waiting.outstanding
    # On a busy computer a late topic cannot be distinguished from a broken one.
    word = "not yet" if waiting.is_busy or waiting.is_cut_short else "MISSING"
    lines += [f"{topic}: {word}" for topic in outstanding]
    if waiting.is_busy and outstanding and not waiting.is_cut_short:
        late = "1 topic has" if len(outstanding) == 1 else f"{len(outstanding)} topics have"
        lines.append(f"this computer is too busy: {late} not arrived yet")
    # Without a time limit no topic counts as missing.
    if waiting.asked_s is None or not outstanding:
        return lines, 0
    is_late = waiting.is_busy and not waiting.is_cut_short
    return lines, EXIT_BUSY if is_late else EXIT_MISSING


def main() -> None:
    """Show the table until SIGINT or a time limit; see the module for the exit codes."""
    raise_limit()
    parser = argparse.ArgumentParser(description="A live table of all biosensor topics.")
    parser.add_argument("--seconds", type=float, help="counted from the first sample")
    parser.add_argument("--expect", type=Path, help="JSON file of topics to wait for")
    options = parser.parse_args()
    reasons: dict[str, str] = json.loads(options.expect.read_text()) if options.expect else {}
    expected = [topic for topic, reason in reasons.items() if not reason]
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        stopping.set()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    elsewhere = ensure_log_folder(os.environ)
    if elsewhere:
        sys.stderr.write(f"{elsewhere}\n")
    rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
    waiting = Waiting(expected, monotonic(), options.seconds)
    node = LiveTable(waiting)
    try:
        _spin(node, waiting, stopping)
    finally:
        node.stop()
        node.destroy_node()
        rclpy.shutdown()
    raise SystemExit(_conclude(node, waiting, reasons))


def _spin(node: LiveTable, waiting: Waiting, stopping: threading.Event) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    processor = ProcessorWait()
    shown = monotonic()
    while not stopping.is_set():
        executor.spin_once(timeout_sec=0.1)
        now = monotonic()
        if now - shown >= REFRESH_S:
            shown = now
            waiting.is_busy |= processor.is_long()
            # Rendered also without a terminal, because rates are measured between two renderings.
            table = render(list(node.rows.values()), columns(sys.stdout))
            if sys.stdout.isatty():
                height = shutil.get_terminal_size((WIDTH, 0)).lines
                sys.stdout.write(f"{_CLEAR}{top(table, height)}\n")
                sys.stdout.flush()
        if now >= waiting.end_s:
            break
    waiting.is_cut_short = stopping.is_set()
    executor.shutdown()


def _conclude(node: LiveTable, waiting: Waiting, reasons: Mapping[str, str]) -> int:
    sys.stdout.write(render(list(node.rows.values()), columns(sys.stdout)) + "\n")
    if not waiting.has_begun:
        sys.stdout.write(f"nothing received within {waiting.first_limit_s:.0f} s\n")
    lines, code = summary(waiting, reasons)
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return code if waiting.has_begun or code else EXIT_MISSING


def fitted(lines: Sequence[Line], width: int) -> Sequence[Line]:
    """Shorten the lines of a table, headings first, to fit a width.

    A prefix of all topics moves to the heading; then types, values, names and at last
    values again are shortened. A table that fits is not changed.
    """
    if _total(lines) <= width:
        return lines
    headings, *rows = lines
    lines = [(f"topic in {_PREFIX}", *headings[1:]), *(_brief(row) for row in rows)]
    lines = _narrowed(lines, _VALUE, width, _LEAST_VALUE, _short_value)
    lines = _narrowed(lines, _TOPIC, width, _LEAST_TOPIC, shortened)
    # 80 columns need it: a line that wraps would move the headings out of a low terminal.
    return _narrowed(lines, _VALUE, width, _SHORTEST_VALUE, _short_value)


def widths(lines: Sequence[Line]) -> list[int]:
    """Return the width of each column."""
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


def _total(lines: Sequence[Line]) -> int:
    each = widths(lines)
    return sum(each) + _GAP * (len(each) - 1)


def _brief(row: Line) -> Line:
    topic, kind, *others = row
    return (
        topic.removeprefix(_PREFIX),
        kind.replace("MultiArray", "[]").replace("Array", "[]"),
        *others,
    )


def _narrowed(
    lines: Sequence[Line],
    column: int,
    width: int,
    least: int,
    shorten: Callable[[str, int], str],
) -> Sequence[Line]:
    allowed = max(least, widths(lines)[column] - max(0, _total(lines) - width))
    return [(*line[:column], shorten(line[column], allowed), *line[column + 1 :]) for line in lines]


def _short_value(text: str, width: int) -> str:
    """Shorten a value, keeping the unit of a number and the beginning of a text."""
    if len(text) <= width:
        return text
    words = text.split(" ")
    brief = f"{words[0]} ... {words[-1]}"
    if len(brief) <= width and not text.startswith(("{", "[")):
        return brief
    return f"{text[: width - 3]}..."


if __name__ == "__main__":
    main()
