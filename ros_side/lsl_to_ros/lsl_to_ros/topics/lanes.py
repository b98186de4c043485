"""Spreads bursts of a topic's messages, so that they fit subscribers' queues.

Devices send in bursts, by Bluetooth up to 73 samples at once, and a subscriber's queue
usually holds 5 or 10 messages. A single message is published at once, by the thread that
read it. Other messages wait in the `Lane` of their topic, from which one thread, the `Pacer`,
publishes them in order and sample by sample.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, cast

from rclpy.serialization import deserialize_message, serialize_message

from biosensor_common.refusal import Refusal, Refusals

MOST_RATE_HZ = 100_000.0
# Messages sent without a pause: as many as a busy computer reads at once of a stream without
# bursts. A subscriber with a queue of 5 then has room for the messages of the next 6 ms.
AT_ONCE = 2
# Factor by which the pace exceeds the rate, or a fast stream would never catch up.
HEADROOM = 2.0
# A fast stream may send the messages of this time without a pause: the pump polls it every
# 2 ms, and the pacer's thread waits until a reader releases the GIL.
USUAL_S, LATE_S = 0.002, 0.010
# Messages of this time may be sent at once by a late turn, or late turns would add up.
LATE_SHARE = 0.02
# More messages than devices send at once are a backlog. The pace grows with it, so that it would
# be empty after this time. The backlog of 5 s is gone within 2 s.
BACKLOG, BACKLOG_S = 256, 0.5
# Beyond this number of messages, or those of a second, samples stay in LSL's buffer.
MOST_WAITING = 10_000
# A publisher's queue is finite, too. When a backlog has filled half of it, publishing pauses until
# the subscribers have received all, except for one that has stopped.
TAKEN_WITHIN_S, TAKEN_CHECK_S = 0.5, 0.01
# The pacer publishes for all topics together, because waking a subscriber once is cheaper.
# At the end, waiting messages are still paced for this time.
TICK_S, LAST_S = 0.002, 1.0

Clock = Callable[[], float]


class Pace:
    """Largest rate of messages per topic; shared by all lanes."""

    def __init__(self, per_ms: float = 0.0) -> None:
        # Messages of one topic per millisecond, 0 for no limit; may change at any time.
        self.per_ms = per_ms

    def interval(self, rate: float, waiting: int = 0) -> float:
        """Return the seconds between two messages of a topic of *rate* Hz with a backlog."""
        if self.per_ms <= 0.0:
            return 0.0
        hurry = rate + waiting / BACKLOG_S if waiting > BACKLOG else 0.0
        return 1.0 / max(1000.0 * self.per_ms, HEADROOM * rate, hurry)


class Lane:
    """Publishes the messages of one topic in order, at once or paced.

    Parameters
    ----------
    publish
        Publishes a message, or its bytes.
    is_taken
        Returns without waiting whether the subscribers have received all messages.
    rate
        Rate of the messages in Hz, 0 if irregular.
    piece
        Number of messages of a backlog after which the subscribers must have received all.
    topic
        Name of the topic for reports.

    Attributes
    ----------
    unsent
        Number of messages that waited and that ROS then failed to publish.
    not_taken
        Number of messages that were published although subscribers had not received earlier ones.
    """

    def __init__(
        self,
        publish: Callable[[Any], None],
        is_taken: Callable[[], bool],
        pacer: Pacer,
        *,
        rate: float,
        piece: int,
        topic: str = "",
    ) -> None:
        self._topic = topic
        self.sent = self.unsent = self.not_taken = 0
        self._publish = publish
        self._is_taken = is_taken
        # A foreign stream may announce any rate.
        self._rate = min(rate, MOST_RATE_HZ)
        self._most_waiting = max(MOST_WAITING, self._rate)
        self._piece = piece
        self._pacer = pacer
        # Held during a publish, so that messages keep their order.
        self._lock = threading.Lock()
        # Messages with the time since when they wait.
        self._messages: deque[tuple[float, Any]] = deque()
        self._now_s = self._turn_s = 0.0
        self._interval_s = 0.0
        self._unchecked = 0
        self._held_until_s: float | None = None
        self._keeps_up = True

    @property
    def waiting(self) -> int:
        """Number of messages that are not published yet."""
        return len(self._messages)

    @property
    def age_s(self) -> float:
        """Return for how many seconds the oldest message has waited; 0 if none does."""
        try:
            # The pacer's thread may take it at any time.
            return max(0.0, self._pacer.clock() - self._messages[0][0])
        except IndexError:
            return 0.0

    @property
    def is_full(self) -> bool:
        """Whether its stream should not be read now; messages that are sent anyway wait, too."""
        return len(self._messages) >= self._most_waiting

    def send(self, messages: Iterable[Any]) -> None:
        """Publish messages in order, now as far as the pace allows, the rest later.

        Raises ROS's error for a message that it cannot convert; those before it are sent.
        """
        with self._lock:
            was_idle = not self._messages
            if was_idle:
                self._unchecked = 0
                self._look(USUAL_S)
            try:
                for message in messages:
                    if self._messages or not self._is_next():
                        self._messages.append((self._pacer.clock(), _copy(message)))
                    else:
                        self._send(message)
            finally:
                if was_idle and self._messages:
                    self._pacer.wake(self)

    def release(self) -> float | None:
        """Publish scheduled messages; return the seconds until the next, None if none waits."""
        with self._lock:
            self._look(LATE_S)
            while self._messages and self._is_next():
                self._send_waiting()
            if not self._messages:
                # nothing is dropped: nothing waits
                return None
            return self._turn_s - self._now_s if self._held_until_s is None else TAKEN_CHECK_S

    def flush(self) -> None:
        """Publish all waiting messages now."""
        with self._lock:
            while self._messages:
                self._send_waiting()

    def _look(self, span_s: float) -> None:
        """Update the allowance of messages without a pause, at most those of a time span."""
        self._now_s = self._pacer.clock()
        waiting = len(self._messages)
        self._interval_s = self._pacer.pace.interval(self._rate, waiting)
        at_once = max(AT_ONCE, HEADROOM * self._rate * span_s, waiting * LATE_SHARE)
        self._turn_s = max(self._turn_s, self._now_s - (at_once - 1) * self._interval_s)

    def _is_next(self) -> bool:
        if self._turn_s > self._now_s:
            return False
        return self._unchecked < self._piece or not self._is_held()

    def _is_held(self) -> bool:
        """Whether to wait until the subscribers have received all published messages."""
        if self._held_until_s is None:
            self._held_until_s = self._now_s + (TAKEN_WITHIN_S if self._keeps_up else 0.0)
        is_taken = self._is_taken()
        if not is_taken and self._now_s < self._held_until_s:
            return True
        self.not_taken += 0 if is_taken else self._unchecked
        self._keeps_up, self._unchecked, self._held_until_s = is_taken, 0, None
        return False

    def _send(self, message: object) -> None:
        self._turn_s += self._interval_s
        self._unchecked += 1
        self._publish(message)
        self.sent += 1

    def _send_waiting(self) -> None:
        try:
            self._send(self._messages.popleft()[1])
        except RuntimeError as error:
            # rclpy raises several classes. Other topics and later messages are not affected.
            self.unsent += 1
            self._pacer.refusals.refuse(Refusal.UNSENT, about=self._topic, why=error)


class Pacer:
    """A thread that publishes the waiting messages of all lanes in turn.

    Parameters
    ----------
    warn
        Called with a sentence when ROS fails to publish a waiting message.
    """

    def __init__(
        self, pace: Pace, warn: Callable[[str], None], clock: Clock = time.monotonic
    ) -> None:
        self.pace = pace
        # Reports of messages that ROS failed to publish, and others about topics.
        self.refusals = Refusals(warn)
        self.clock = clock
        self._busy: set[Lane] = set()
        self._changed = threading.Condition()
        self._stop_at_s: float | None = None
        self._thread = threading.Thread(target=self._run, daemon=True, name="pace")

    def start(self) -> None:
        """Start the thread; until then messages stay in their lanes."""
        self._thread.start()

    def wake(self, lane: Lane) -> None:
        """Notify the thread that messages wait in a lane."""
        with self._changed:
            self._busy.add(lane)
            self._changed.notify()

    def turn(self) -> float | None:
        """Publish scheduled messages; return the seconds until the next, None if none waits."""
        with self._changed:
            lanes, self._busy = self._busy, set()
        # A lane that fills again in the meantime wakes us by itself.
        left = {lane: wait_s for lane in lanes if (wait_s := lane.release()) is not None}
        with self._changed:
            self._busy.update(left)
        return min(left.values()) if left else None

    def stop(self) -> None:
        """Publish waiting messages, for a second paced and then at once, and end the thread."""
        with self._changed:
            self._stop_at_s = self.clock() + LAST_S
            self._changed.notify()
        self._thread.join()
        for lane in self._busy:
            lane.flush()

    def _run(self) -> None:
        while self._await_lanes():
            wait_s = self.turn()
            if wait_s is not None:
                time.sleep(max(wait_s, TICK_S))

    def _await_lanes(self) -> bool:
        """Wait until a lane has messages; return whether to continue."""
        with self._changed:
            self._changed.wait_for(lambda: self._busy or self._stop_at_s is not None)
            if self._stop_at_s is None:
                return True
            return bool(self._busy) and self.clock() < self._stop_at_s


def _copy(message: object) -> object:
    """Return a copy of a message to wait; one that ROS cannot convert fails when it is sent."""
    if isinstance(message, bytes):
        return message
    # Its bytes cannot be used, because ROS gives them the estimated length, which is up to 7 more
    # than the message has, and strict bag readers refuse those.
    return deserialize_message(serialize_message(message), cast("type[Any]", type(message)))
