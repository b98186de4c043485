"""Bags made of recordings, and recordings made of bags."""
