"""Turns samples into messages and publishes them."""
