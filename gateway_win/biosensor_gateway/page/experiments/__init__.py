"""Receives the markers of web experiments, at a separate port and with a separate token."""
