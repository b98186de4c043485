"""The characteristics of a headband.

Source: the UUIDs that muse-js, muse-lsl and BrainFlow use.
"""

from __future__ import annotations


def _uuid(number: int) -> str:
    return f"273e{number:04x}-4c4d-454d-96be-f03bac821358"


SERVICE = "0000fe8d-0000-1000-8000-00805f9b34fb"
CONTROL = _uuid(0x01)
EEG = (_uuid(0x03), _uuid(0x04), _uuid(0x05), _uuid(0x06))
"""TP9, AF7, AF8, TP10."""
AUX = _uuid(0x07)
GYRO, ACC, TELEMETRY = _uuid(0x09), _uuid(0x0A), _uuid(0x0B)
PPG = (_uuid(0x0F), _uuid(0x10), _uuid(0x11))
"""Ambient, infrared, red."""
FRAMES = (_uuid(0x13), _uuid(0x14))
"""Of an Athena, which sends everything on them; firmware may have the first one only."""
