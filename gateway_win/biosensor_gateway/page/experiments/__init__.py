"""Markers that web experiments send, by an address and a token of their own."""
