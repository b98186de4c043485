"""How a Shimmer refuses a command."""

from __future__ import annotations

ASKED = ("", "3r")
"""Kinds of virtual devices with requests of their own; the others have the same with other bits."""


def refusal(request: bytes) -> bytes:
    """Return the NACK of a command."""
    return b"\xfe"
