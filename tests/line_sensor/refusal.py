"""A line sensor is asked nothing: it sends by itself."""

from __future__ import annotations

ASKED = ()
"""Kinds of virtual devices whose driver asks something."""
