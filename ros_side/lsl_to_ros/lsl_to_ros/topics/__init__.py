"""Converts samples to messages and publishes them."""
