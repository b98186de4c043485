"""The source of traces, as the WebSocket needs it."""

from __future__ import annotations

from typing import Protocol

from biosensor_gateway.page.traces import Traces


class Source(Protocol):
    """Where the page has its streams from: an agent's memory, or the network.

    Attributes
    ----------
    traces
        What came; the source adds to it.
    has_ended
        Whether somebody has ended the page.
    turns
        How often all has changed, so that nobody who looks should wait for the next status.
    """

    traces: Traces
    has_ended: bool
    turns: int

    def now(self) -> float:
        """Return the LSL time in seconds."""
        ...
