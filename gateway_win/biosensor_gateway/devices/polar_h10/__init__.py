"""Polar H10 chest strap over Bluetooth LE."""
