"""Watches a recording while it is written, whoever writes it."""
