"""Packets of a Muse 2 or Muse S as it writes them: 20 bytes, big-endian.

Sources: muse-lsl (`muse.py`), muse-js (`muse-parse.ts`) and BrainFlow (`muse.cpp`), which agree
on 12 samples of 12 bits, 6 of 24 bits, 3 times 3 of 16 bits, and on their scales.
"""

from __future__ import annotations

import struct

import numpy as np

from biosensor_gateway.devices.muse.simulator.wire import uuid
from biosensor_gateway.simulation.wearer import Floats

EEG_UUIDS = {"TP9": uuid(3), "AF7": uuid(4), "AF8": uuid(5), "TP10": uuid(6)}
AUX_UUID, GYRO_UUID, ACC_UUID, TELEMETRY_UUID = uuid(7), uuid(9), uuid(10), uuid(11)
LIGHT_UUIDS = {"ambient": uuid(15), "infrared": uuid(16), "red": uuid(17)}
EEG_COUNT, LIGHT_COUNT, MOTION_COUNT = 12, 6, 3
_UV, _G, _DPS = 0.48828125, 1 / 16384, 245 / 32768
_FULL_12, _FULL_24 = (1 << 12) - 1, (1 << 24) - 1


def eeg(number: int, microvolts: Floats) -> tuple[bytes, Floats]:
    """Return a packet of one electrode, and the values that it holds [uV]."""
    counts = np.clip(np.rint(microvolts / _UV) + 2048, 0, _FULL_12).astype(int)
    bits = 0
    for count in counts:
        bits = bits << 12 | int(count)
    return struct.pack(">H", number & 0xFFFF) + bits.to_bytes(18, "big"), (counts - 2048) * _UV


def light(number: int, values: Floats) -> tuple[bytes, Floats]:
    """Return a packet of one photodiode, and the values that it holds [counts]."""
    counts = np.clip(np.rint(values), 0, _FULL_24).astype(int)
    body = b"".join(int(count).to_bytes(3, "big") for count in counts)
    return struct.pack(">H", number & 0xFFFF) + body, counts.astype(float)


def acceleration(number: int, g: Floats) -> tuple[bytes, Floats]:
    """Return a packet of acceleration, and the values that it holds [g]."""
    return _motion(number, g, _G)


def rotation(number: int, degrees_per_s: Floats) -> tuple[bytes, Floats]:
    """Return a packet of rotation, and the values that it holds [deg/s]."""
    return _motion(number, degrees_per_s, _DPS)


def telemetry(number: int, percent: float) -> tuple[bytes, float]:
    """Return a packet of battery and temperature, and the percentage that it holds."""
    raw = round(percent * 512)
    fields = struct.pack(">HHHHH", number & 0xFFFF, raw, 1700, 3900, 25)
    return fields.ljust(20, b"\0"), raw / 512


def _motion(number: int, values: Floats, unit: float) -> tuple[bytes, Floats]:
    counts = np.clip(np.rint(values / unit), -32768, 32767).astype(">i2")
    return struct.pack(">H", number & 0xFFFF) + counts.tobytes(), counts * unit
