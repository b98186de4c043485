"""Empatica E4 wristband, by way of the vendor's streaming server."""
