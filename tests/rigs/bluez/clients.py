"""The programs on a bus, and when they leave it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Protocol, cast

from dbus_fast.aio import MessageBus
from dbus_fast.message import Message

_DAEMON = "org.freedesktop.DBus"
_MEMBER = "NameOwnerChanged"


class _Bus(Protocol):
    """What is used of the bus, whose annotation leaves a type argument out."""

    def call(self, msg: Message) -> Awaitable[object]: ...


async def watch_clients(
    bus: MessageBus, on_left: Callable[[str], Coroutine[Any, Any, None]]
) -> None:
    """Call back with the unique name of each program that leaves, killed or not."""
    running: set[asyncio.Task[None]] = set()

    def on_message(message: Message) -> None:
        if message.member == _MEMBER and message.interface == _DAEMON:
            name, _, owner = message.body
            if not owner:
                task = asyncio.ensure_future(on_left(name))
                running.add(task)
                task.add_done_callback(running.discard)

    bus.add_message_handler(on_message)
    rule = f"type='signal',interface='{_DAEMON}',member='{_MEMBER}'"
    await cast("_Bus", bus).call(
        Message(
            destination=_DAEMON,
            path="/org/freedesktop/DBus",
            interface=_DAEMON,
            member="AddMatch",
            signature="s",
            body=[rule],
        )
    )
