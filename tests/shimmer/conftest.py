"""Loops that can go by a clock of their own."""

from __future__ import annotations

from tests.rigs.virtual_time import virtual_clock

__all__ = ["virtual_clock"]
