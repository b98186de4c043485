"""Counts what came, what was lost and when it was measured."""
