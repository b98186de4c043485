"""Spreads a topic's messages if more come at once than subscribers can queue.

Devices send in bursts, by Bluetooth up to 73 samples at once, and a subscriber's queue
usually holds 5 or 10 messages. What comes alone goes out at once, in the thread that read
it. The rest waits in the `Lane` of its topic, from which one thread, the `Pacer`,
publishes it in order and sample by sample.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, cast

from rclpy.serialization import deserialize_message, serialize_message

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals

MOST_RATE_HZ = 100_000.0
# Sent without a pause: what a busy computer reads together of a stream without bursts. A
# subscriber with a queue of 5 then has room for what the next 6 ms bring.
AT_ONCE = 2
# Paced faster than it comes by so much, or a fast stream would never catch up.
HEADROOM = 2.0
# What a fast stream may send without a pause comes from so long: the pump looks at it every
# 2 ms, and the pacer's thread waits for the interpreter until a reader lets it go.
USUAL_S, LATE_S = 0.002, 0.010
# Of what waits, a turn that comes late may send so much, lest many of them leave it behind.
LATE_SHARE = 0.02
# More than devices send at once is a backlog: the longer, the faster it goes out, for beside
# what comes, so long would empty it. What 5 s have held up is gone within 2 s.
BACKLOG, BACKLOG_S = 256, 0.5
# Beyond so many messages, or a second's, the rest is left in LSL's buffer.
MOST_WAITING = 10_000
# A publisher's queue is finite, too. When a backlog has filled half of it, the subscribers
# must have all before it goes on; one that has stopped is not waited for.
TAKEN_WITHIN_S, TAKEN_CHECK_S = 0.5, 0.01
# The pacer publishes for all topics together, for a subscriber of many is cheaper to wake once.
# When it ends, what waits has so long to go out paced.
TICK_S, LAST_S = 0.002, 1.0

Clock = Callable[[], float]


class Pace:
    """How many messages a topic may send; shared by all lanes.

    Attributes
    ----------
    per_ms
        Messages of one topic in a millisecond, 0 for no limit; may change at any time.
    """

    def __init__(self, per_ms: float = 0.0) -> None:
        self.per_ms = per_ms

    def interval(self, rate: float, waiting: int = 0) -> float:
        """Return the seconds between two messages of a topic of *rate* Hz with a backlog."""
        if self.per_ms <= 0.0:
            return 0.0
        hurry = rate + waiting / BACKLOG_S if waiting > BACKLOG else 0.0
        return 1.0 / max(1000.0 * self.per_ms, HEADROOM * rate, hurry)


class Lane:
    """Publishes the messages of one topic in order: at once, or when their turn has come.

    Parameters
    ----------
    publish
        Publishes a message, or the bytes of one.
    is_taken
        Says without waiting whether the subscribers have all that was published.
    pacer
        Publishes what waits.
    rate
        Of the messages in Hz, 0 if they are irregular.
    piece
        After how many messages of a backlog the subscribers must have all.
    topic
        What is told of it is about that.

    Attributes
    ----------
    sent
        Messages published.
    unsent
        Messages that waited and that ROS then failed to publish.
    not_taken
        Messages that went out although the subscribers had not taken those before for too long.
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
        # The rate of another program's stream may be any number.
        self._rate = min(rate, MOST_RATE_HZ)
        self._most_waiting = max(MOST_WAITING, self._rate)
        self._piece = piece
        self._pacer = pacer
        # Held while something is published, so that messages go out in the order of sending.
        self._lock = threading.Lock()
        # Each with the time since when it waits.
        self._messages: deque[tuple[float, Any]] = deque()
        self._now_s = self._turn_s = 0.0
        self._interval_s = 0.0
        self._unchecked = 0
        self._held_until_s: float | None = None
        self._keeps_up = True

    @property
    def waiting(self) -> int:
        """Messages that have not gone out yet."""
        return len(self._messages)

    @property
    def age_s(self) -> float:
        """For how many seconds the oldest message has waited; 0 if none does."""
        try:
            # The pacer's thread may take it at any time.
            return max(0.0, self._pacer.clock() - self._messages[0][0])
        except IndexError:
            return 0.0

    @property
    def is_full(self) -> bool:
        """Whether its stream should be read no further; what is sent all the same waits, too."""
        return len(self._messages) >= self._most_waiting

    def send(self, messages: Iterable[Any]) -> None:
        """Publish messages in their order, those now whose turn it is.

        A message that ROS cannot convert raises what ROS raises; those before it are sent.
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
        """Publish what is due; return in how many seconds more is, None if nothing waits."""
        with self._lock:
            self._look(LATE_S)
            while self._messages and self._is_next():
                self._send_waiting()
            if not self._messages:
                # nothing is dropped: nothing waits
                return None
            return self._turn_s - self._now_s if self._held_until_s is None else TAKEN_CHECK_S

    def flush(self) -> None:
        """Publish all that waits, now."""
        with self._lock:
            while self._messages:
                self._send_waiting()

    def _look(self, span_s: float) -> None:
        """Look at the clock; what may go out without a pause is at most what comes in a span."""
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
        """Whether the subscribers must have what has gone out before more does."""
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
            # Each of rclpy's errors is one. Other topics and the rest of this one go on.
            self.unsent += 1
            self._pacer.refusals.refuse(Refusal.UNSENT, about=self._topic, why=error)


class Pacer:
    """One thread that publishes what waits in all lanes, each in turn.

    Parameters
    ----------
    warn
        Called with a sentence when ROS fails to publish something that waited.

    Attributes
    ----------
    refusals
        What ROS failed to publish, and what else concerns topics.
    """

    def __init__(
        self, pace: Pace, warn: Callable[[str], None], clock: Clock = time.monotonic
    ) -> None:
        self.pace = pace
        self.refusals = Refusals(warn)
        self.clock = clock
        self._busy: set[Lane] = set()
        self._changed = threading.Condition()
        self._stop_at_s: float | None = None
        self._thread = threading.Thread(target=self._run, daemon=True, name="pace")

    def start(self) -> None:
        """Begin; until then what waits stays where it is."""
        self._thread.start()

    def wake(self, lane: Lane) -> None:
        """Take note that something waits in a lane."""
        with self._changed:
            self._busy.add(lane)
            self._changed.notify()

    def turn(self) -> float | None:
        """Publish what is due; return in how many seconds more is, None if nothing waits."""
        with self._changed:
            lanes, self._busy = self._busy, set()
        # A lane that fills again in the meantime wakes us by itself.
        left = {lane: wait_s for lane in lanes if (wait_s := lane.release()) is not None}
        with self._changed:
            self._busy.update(left)
        return min(left.values()) if left else None

    def stop(self) -> None:
        """Publish what waits, for a second at its pace and then at once, and end."""
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
        """Wait until something waits; return whether to go on."""
        with self._changed:
            self._changed.wait_for(lambda: self._busy or self._stop_at_s is not None)
            if self._stop_at_s is None:
                return True
            return bool(self._busy) and self.clock() < self._stop_at_s


def _copy(message: object) -> object:
    """Return a message of its own to wait; one that ROS cannot convert fails where it is sent."""
    if isinstance(message, bytes):
        return message
    # Its bytes would do, were they not too many: ROS gives them the length that it has
    # estimated, up to 7 more than the message has, and strict readers of bags refuse those.
    return deserialize_message(serialize_message(message), cast("type[Any]", type(message)))
