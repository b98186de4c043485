"""Takes messages from subscriptions in a separate thread."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, NotRequired, TypeAlias, TypedDict

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

REST_S = 0.0015
"""Pause after each round, so that messages close in time are taken together: a round costs more
than a message."""
_WAIT_NS = 50_000_000
_MAX_TAKEN = 200
"""Messages of one subscription per round, so that a flood does not delay the others."""
_END_S = 5.0

RosMessage: TypeAlias = Any
"""A message of any type."""


class MessageInfo(TypedDict):
    """Metadata of a message; None where the middleware does not provide it."""

    # source_timestamp, received_timestamp: times of publication and arrival, in nanoseconds since
    # 1970.
    source_timestamp: int
    received_timestamp: int
    publication_sequence_number: int | None
    # Whether rclpy has cut the text at a NUL character; only known of `std_msgs/msg/String`.
    is_cut: NotRequired[bool]


Take = Callable[[RosMessage, MessageInfo], None]


def nobody(message: RosMessage) -> None:
    """Serve as the callback that rclpy requires; a `Taker` takes the messages instead."""
    del message


class TakenElsewhere(CallbackGroup):
    """Callback group whose subscriptions the node's executor ignores."""

    def can_execute(self, entity: object) -> bool:
        """Return that no executor may take from them."""
        del entity
        return False


class _Entry:
    def __init__(self, subscription: Subscription, take: Take) -> None:
        self.subscription, self.take = subscription, take
        # Stored, because every round needs it and rclpy's property is slow.
        self.handle = subscription.handle
        self.is_text = subscription.msg_type.get_fields_and_field_types() == {"data": "string"}


class Taker:
    """Waits for messages of all subscriptions, and calls each one's receiver.

    An executor of rclpy takes two to three times the processor time.
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
        """Call *take* with each message of a subscription from now on."""
        entry = _Entry(subscription, take)
        self._todo.put(lambda: self._entries.update({subscription.handle.pointer: entry}))

    def remove(self, subscription: Subscription) -> None:
        """Take a subscription's last messages; afterwards it may be destroyed."""
        done = threading.Event()

        def leave() -> None:
            entry = self._entries.pop(subscription.handle.pointer, None)
            if entry is not None:
                self._take(entry)
            done.set()

        self._todo.put(leave)
        done.wait(_END_S)

    def stop(self) -> None:
        """Take the messages received so far, and stop."""
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
                # Text is taken as bytes, because rclpy reads it up to the first NUL.
                taken = take_message(kind, entry.is_text)
                if taken is None:
                    return  # nothing is dropped: nothing has come
                message, info = taken
                if entry.is_text:
                    message, info["is_cut"] = deserialize_message(message, kind), _has_nul(message)
                entry.take(message, info)
        except Exception as error:  # noqa: BLE001 - else no topic would be sent any more
            # nothing is dropped: `failed` reports it
            self._failed(entry.subscription, error)


def _has_nul(content: bytes) -> bool:
    """Whether a serialised string, the only field of a message, has a NUL before its end."""
    order = "<" if content[1] & 1 else ">"
    (length,) = struct.unpack_from(f"{order}I", content, 4)
    return b"\0" in content[8 : 8 + max(0, length - 1)]
