"""Packets and replies, for the speed of decoders: all units have one protocol."""

from tests.shimmer.taped import TAPED

__all__ = ["TAPED"]
