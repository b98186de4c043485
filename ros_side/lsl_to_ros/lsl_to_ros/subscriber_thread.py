"""Takes messages from subscriptions, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeAlias, TypedDict

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

REST_S = 0.0015
"""After each round, so that messages that come close together are taken together: a round
costs more than a message."""
_WAIT_NS = 50_000_000
_MAX_TAKEN = 200
"""Of one subscription in a round, so that a flood does not keep the others waiting."""
_END_S = 5.0

RosMessage: TypeAlias = Any
"""A message of whatever type."""


class MessageInfo(TypedDict):
    """What ROS tells of a message besides; None where the middleware does not know.

    Attributes
    ----------
    source_timestamp, received_timestamp
        When it was published and when it arrived, in nanoseconds since 1970.
    publication_sequence_number
        Counted by its publisher.
    """

    source_timestamp: int
    received_timestamp: int
    publication_sequence_number: int | None


Take = Callable[[RosMessage, MessageInfo], None]


def nobody(message: RosMessage) -> None:
    """Stand where rclpy demands a callback of a subscription from which a `Taker` takes."""
    del message


class TakenElsewhere(CallbackGroup):
    """Keeps subscriptions away from the node's executor."""

    def can_execute(self, entity: object) -> bool:
        """No executor takes from them."""
        del entity
        return False


class _Entry:
    def __init__(self, subscription: Subscription, take: Take) -> None:
        self.subscription, self.take = subscription, take
        # Asked for by every round, which a property of rclpy makes dear.
        self.handle = subscription.handle


class Taker:
    """Waits for messages of any subscription, and hands each to whom it belongs.

    An executor of rclpy takes two to three times the processor time.

    Parameters
    ----------
    node
        That made the subscriptions.
    failed
        Called with an error that a receiver has raised.
    """

    def __init__(self, node: Node, failed: Callable[[Subscription, Exception], None]) -> None:
        self._context = node.context
        self._failed = failed
        self._entries: dict[int, _Entry] = {}
        self._todo: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="take messages")
        self._thread.start()

    def add(self, subscription: Subscription, take: Take) -> None:
        """Hand the messages of a subscription to *take* from now on."""
        entry = _Entry(subscription, take)
        self._todo.put(lambda: self._entries.update({subscription.handle.pointer: entry}))

    def remove(self, subscription: Subscription) -> None:
        """Take what has come, and nothing more; the subscription may be destroyed then."""
        done = threading.Event()

        def leave() -> None:
            entry = self._entries.pop(subscription.handle.pointer, None)
            if entry is not None:
                self._take(entry)
            done.set()

        self._todo.put(leave)
        done.wait(_END_S)

    def stop(self) -> None:
        """Take what has come, and end."""
        self._stopping.set()
        self._thread.join(_END_S)

    def _run(self) -> None:
        wait_set: Any = None
        while not self._stopping.is_set():
            before = len(self._entries), wait_set
            self._do_what_is_to_do()
            if not self._entries:
                time.sleep(_WAIT_NS / 1e9)
                continue  # nothing is dropped: nothing is subscribed
            if wait_set is None or len(self._entries) != before[0]:
                size = len(self._entries)
                wait_set = rclpy_implementation.WaitSet(size, 0, 0, 0, 0, 0, self._context.handle)
            self._round(wait_set)
            time.sleep(REST_S)
        self._do_what_is_to_do()
        for each in self._entries.values():
            self._take(each)

    def _do_what_is_to_do(self) -> None:
        while not self._todo.empty():
            self._todo.get()()

    def _round(self, wait_set: Any) -> None:  # noqa: ANN401 - rclpy has no types for it
        wait_set.clear_entities()
        for each in self._entries.values():
            wait_set.add_subscription(each.handle)
        wait_set.wait(_WAIT_NS)
        for pointer in wait_set.get_ready_entities("subscription"):
            self._take(self._entries[pointer])

    def _take(self, entry: _Entry) -> None:
        take_message, kind = entry.handle.take_message, entry.subscription.msg_type
        try:
            for _ in range(_MAX_TAKEN):
                taken = take_message(kind, False)
                if taken is None:
                    return  # nothing is dropped: nothing has come
                entry.take(*taken)
        except Exception as error:  # noqa: BLE001 - else no topic would be sent any more
            # nothing is dropped: `failed` reports it
            self._failed(entry.subscription, error)
