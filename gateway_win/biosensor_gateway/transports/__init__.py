"""Bytes in and out of devices; nothing here knows what they mean."""
