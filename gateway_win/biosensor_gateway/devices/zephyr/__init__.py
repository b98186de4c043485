"""Zephyr BioHarness 3 over its Bluetooth serial port."""
