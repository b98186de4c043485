"""Exports of recordings."""
