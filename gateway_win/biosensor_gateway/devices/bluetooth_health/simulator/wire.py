"""Values of characteristics as devices write them.

Layouts: Bluetooth SIG, Pulse Oximeter Service 1.0.1, Health Thermometer Service 1.0, Running
Speed and Cadence Service 1.0, Cycling Speed and Cadence Service 1.0, Cycling Power Service 1.1.
"""

from __future__ import annotations

import struct

_NO_NUMBER = 0x07FF
_STATUS_AND_AMPLITUDE = 0x18
_UNCONNECTED_TO_USER = 1 << 11
_TENTHS = 0xF000
"""Exponent -1, above a mantissa of 12 bits."""


def tenths(value: float) -> int:
    """Return a decimal number of 16 bits with one place."""
    return _TENTHS | round(10 * value) & 0x0FFF


def oximeter(spo2: float, pulse: float, amplitude: float, *, worn: bool) -> bytes:
    """Return a continuous measurement with device status and pulse amplitude index."""
    status = 0 if worn else _UNCONNECTED_TO_USER
    numbers = [tenths(each) if worn else _NO_NUMBER for each in (spo2, pulse, amplitude)]
    head = struct.pack("<BHH", _STATUS_AND_AMPLITUDE, *numbers[:2])
    return head + status.to_bytes(3, "little") + struct.pack("<H", numbers[2])


def thermometer(celsius: float) -> bytes:
    """Return a temperature with two places."""
    mantissa = round(100 * celsius) & 0xFFFFFF
    return struct.pack("<BI", 0, mantissa | (-2 & 0xFF) << 24)


def foot_pod(metres_per_second: float, strides_per_minute: int) -> bytes:
    """Return speed and cadence of a runner."""
    return struct.pack("<BHB", 4, round(256 * metres_per_second), strides_per_minute)


def bicycle(wheel_turns: int, wheel_s: float, crank_turns: int, crank_s: float) -> bytes:
    """Return counted turns, and when the last ones were."""
    times = [round(1024 * each) & 0xFFFF for each in (wheel_s, crank_s)]
    counts = wheel_turns & 0xFFFFFFFF, times[0], crank_turns & 0xFFFF, times[1]
    return struct.pack("<BIHHH", 3, *counts)


def power_meter(watts: int) -> bytes:
    """Return a power and nothing else."""
    return struct.pack("<Hh", 0, watts)
