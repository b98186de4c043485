"""Listens to the device, and turns what it advertises into samples."""
