"""Emotiv Insight by way of the Cortex service."""
