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
    """Connected; silent streams have been enabled again and are waited for."""
    BACKOFF = "backoff"
    STOPPED = "stopped"


CONNECTED = frozenset({State.STREAMING.value, State.ENABLING.value})
"""While one stream is asked for again, the others flow."""

STATE_WORDS = {
    State.DISCOVERING.value: "looking for it",
    State.CONNECTING.value: "connecting",
    State.STREAMING.value: "streaming",
    State.ENABLING.value: "no data yet",
    State.BACKOFF.value: "will try again",
    State.STOPPED.value: "stopped",
}
"""What people are told; files and streams have the value."""


def is_sending(state: str, *, paused: bool) -> bool:
    """Whether a device sends, so that what it sent last may be of now."""
    return state in CONNECTED and not paused
