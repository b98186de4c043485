"""Limits of a replay's speed, in seconds of the recording in one second."""

SLOWEST, FASTEST = 0.01, 1000.0
