"""Warnings: what Cortex tells without being asked."""

from __future__ import annotations

import json

Announcement = str | dict[str, str]
"""A warning's message: a text, or what happened to which headset or session."""


def warning(code: int, message: Announcement) -> str:
    """Write a warning."""
    return json.dumps({"jsonrpc": "2.0", "warning": {"code": code, "message": message}})
