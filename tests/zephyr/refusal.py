"""How the BioHarness refuses a message."""

from __future__ import annotations


def refusal(request: bytes) -> bytes:
    """Return the NAK of a message."""
    return bytes((0x02, request[1], 0, 0, 0x15))
