"""An EmotiBit is asked by UDP broadcast, where lost requests are usual."""

from __future__ import annotations

ASKED = ()
"""Kinds of virtual devices whose driver asks something."""
