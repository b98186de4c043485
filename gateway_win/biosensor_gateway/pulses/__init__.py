"""Finds pulses in a photoplethysmogram, for features and for devices that send no heart rate."""
