"""How a Shimmer refuses a command."""

from __future__ import annotations


def refusal(request: bytes) -> bytes:
    """Return the NACK of a command."""
    return b"\xfe"
