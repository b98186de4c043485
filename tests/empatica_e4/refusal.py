"""How the server refuses a command."""

from __future__ import annotations


def refusal(request: bytes) -> bytes:
    """Return the answer to a refused command."""
    return b"R " + request.split()[0] + b" ERR refused\n"
