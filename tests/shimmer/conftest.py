"""Loops that can go by a clock of their own."""

from __future__ import annotations

from tests.rigs.virtual_time import pytest_asyncio_loop_factories, virtual_clock

__all__ = ["pytest_asyncio_loop_factories", "virtual_clock"]
