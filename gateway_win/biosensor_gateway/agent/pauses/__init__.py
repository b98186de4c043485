"""Pauses: a participant who withdraws sends nothing until the device is resumed."""
