"""Takes messages from subscriptions in a separate thread."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from functools import cache
from importlib import import_module
from queue import SimpleQueue
from typing import Any, NotRequired, TypeAlias, TypedDict

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    AbstractType,
    Array,
    BasicType,
    NamespacedType,
)

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
    # Whether rclpy has cut a text at a NUL character.
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
        self.steps = steps_of(subscription.msg_type)


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
                # What has text is taken as bytes, because rclpy reads it up to the first NUL.
                taken = take_message(kind, bool(entry.steps))
                if taken is None:
                    return  # nothing is dropped: nothing has come
                message, info = taken
                if entry.steps:
                    info["is_cut"] = has_nul(message, entry.steps)
                    message = deserialize_message(message, kind)
                entry.take(message, info)
        except Exception as error:  # noqa: BLE001 - else no topic would be sent any more
            # nothing is dropped: `failed` reports it
            self._failed(entry.subscription, error)


Step = tuple[int | None, int, "tuple[Step, ...]"]
"""One field of a serialised message: how many there are, None for a sequence with its own count;
the size of a number, 0 for text or a message; and the fields of the message, none for text."""
_SIZES = {
    "octet": 1,
    "char": 1,
    "boolean": 1,
    "float": 4,
    "double": 8,
    "long double": 16,
    **{f"{sign}int{8 * size}": size for sign in ("", "u") for size in (1, 2, 4, 8)},
}
# XCDR1, the encoding of all messages in ROS 2 that have no optional fields.
_BIG, _LITTLE = b"\0\0", b"\0\1"
_NOTHING: Step = (1, 1, ())
"""A message without fields has one byte."""


@cache
def steps_of(kind: type[Any]) -> tuple[Step, ...]:
    """Return the fields of a message type; none if it has no text, or it cannot be followed."""
    try:
        steps = _steps(kind)
    except KeyError:
        # The size of wide text differs between implementations.
        # nothing is dropped: it is taken as any other message
        return ()
    return steps if any(map(_has_text, steps)) else ()


def _steps(kind: type[Any]) -> tuple[Step, ...]:
    return tuple(map(_step, kind.SLOT_TYPES)) or (_NOTHING,)


def _step(slot: AbstractType) -> Step:
    if isinstance(slot, Array):
        _, size, inside = _step(slot.value_type)
        return slot.size, size, inside
    if isinstance(slot, AbstractSequence):
        _, size, inside = _step(slot.value_type)
        return None, size, inside
    if isinstance(slot, NamespacedType):
        return 1, 0, _steps(getattr(import_module(".".join(slot.namespaces)), slot.name))
    if isinstance(slot, AbstractString):
        return 1, 0, ()
    assert isinstance(slot, BasicType)
    return 1, _SIZES[slot.typename], ()


def _has_text(step: Step) -> bool:
    _, size, inside = step
    return not size and (not inside or any(map(_has_text, inside)))


def has_nul(content: bytes, steps: tuple[Step, ...]) -> bool:
    """Whether a text of a serialised message has a NUL character before its end."""
    encoding, body = content[:2], content[4:]
    if encoding not in (_BIG, _LITTLE):
        return False
    count_of = struct.Struct("<I" if encoding == _LITTLE else ">I").unpack_from

    def follow(steps: tuple[Step, ...], place: int) -> tuple[int, bool]:
        for fixed, size, inside in steps:
            count = fixed
            if count is None:
                place += -place % 4
                (count,) = count_of(body, place)
                place += 4
            if size:
                place += -place % min(size, 8) if count else 0
                place += count * size
                continue  # nothing is dropped: numbers are no text
            for _ in range(count):
                if inside:
                    place, is_found = follow(inside, place)
                else:
                    place += -place % 4
                    (length,) = count_of(body, place)
                    begin, place = place + 4, place + 4 + length
                    is_found = b"\0" in body[begin : max(begin, place - 1)]
                if is_found:
                    return place, True
        return place, False

    try:
        return follow(steps, 0)[1]
    except struct.error:
        # nothing is dropped: what is shorter than its type is an error when it is read
        return False
