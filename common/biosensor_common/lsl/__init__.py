"""Finds and opens LSL streams, in the same way in all programs."""
