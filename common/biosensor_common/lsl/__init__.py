"""Finds and opens streams of LSL in the same way in all programs."""
