"""The states of a device on its way to streaming."""

from __future__ import annotations

from enum import Enum, unique


@unique
class State(Enum):
    """Where a device is on its way to streaming."""

    DISCOVERING = "discovering"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    ENABLING = "enabling"
    """Connected; silent streams were enabled again, and their samples have not arrived yet."""
    BACKOFF = "backoff"
    STOPPED = "stopped"


CONNECTED = frozenset({State.STREAMING.value, State.ENABLING.value})
"""``ENABLING`` is included because the other streams deliver meanwhile."""

STATE_WORDS = {
    State.DISCOVERING.value: "looking for it",
    State.CONNECTING.value: "connecting",
    State.STREAMING.value: "streaming",
    State.ENABLING.value: "no data yet",
    State.BACKOFF.value: "will try again",
    State.STOPPED.value: "stopped",
}
"""The states for people; files and streams have the enum's values."""


def is_sending(state: str, *, paused: bool) -> bool:
    """Whether a device is sending, so that its last values can be current."""
    return state in CONNECTED and not paused
