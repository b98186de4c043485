"""Encodes a sensor's messages of the GATT SensorData Protocol.

Sources: Movesense's "GATT SensorData Protocol specification" and the firmware sample
gatt_sensordata_app of the Movesense device library.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from biosensor_gateway.simulation.wearer import Floats

SERVICE_UUID = "34802252-7185-4D5D-B431-630E7050E8F0"
COMMAND_UUID = "34800001-7185-4D5D-B431-630E7050E8F0"
DATA_UUID = "34800002-7185-4D5D-B431-630E7050E8F0"

HELLO, SUBSCRIBE, UNSUBSCRIBE = 0, 1, 2
ANSWER = 1
# Codes of a packet's first part and of the following parts.
_PARTS = (2, 3, 4)
OK, BAD_REQUEST, FORBIDDEN, NOT_FOUND, NO_SLOT = 200, 400, 403, 404, 507
SLOTS = 4
FULL_MTU = 161
ATT_HEADER_BYTES = 3
_PROTOCOL_VERSION = 1
ECG_RATES = (125, 128, 200, 250, 256, 500, 512)
IMU_RATES = (13, 26, 52, 104, 208)
ECG_SAMPLES = 16
COUNT_UV = 0.381469726563
GRAVITY = 9.80665
_PATH = re.compile(r"/?Meas/(?P<kind>[A-Za-z0-9]+)(?:/(?P<rate>\d+))?(?P<scaled>/mV)?")
VECTORS = {
    "acc": ("acc",),
    "gyro": ("gyro",),
    "magn": ("mag",),
    "imu6": ("acc", "gyro"),
    "imu6m": ("acc", "mag"),
    "imu9": ("acc", "gyro", "mag"),
}


class Resource(NamedTuple):
    """The resource of a path."""

    kind: str  # Lower case: `ecg`, `hr`, `temp` or a key of `VECTORS`.
    rate_hz: int = 0  # 0 if it has no rate.
    scaled: bool = False  # Whether the firmware converts the ECG.


def resource(path: bytes) -> Resource | None:
    """Return the resource of a path; None if the firmware does not have it."""
    found = _PATH.fullmatch(path.rstrip(b"\0").decode("ascii", "replace"))
    if found is None:
        return None
    kind, rate, scaled = found["kind"].lower(), int(found["rate"] or 0), bool(found["scaled"])
    rates = ECG_RATES if kind == "ecg" else IMU_RATES if kind in VECTORS else (0,)
    is_known = kind in VECTORS or kind in ("ecg", "hr", "temp")
    fits = is_known and rate in rates and (kind == "ecg" or not scaled)
    return Resource(kind, rate, scaled) if fits else None


def status(reference: int, code: int) -> bytes:
    """Return the answer to a command."""
    return struct.pack("<BBH", ANSWER, reference, code)


def greeting(reference: int, serial: str, *, old: bool) -> bytes:
    """Return the answer to ``HELLO``."""
    if old:
        return bytes((ANSWER, reference)) + b"Hello"
    texts = (serial, "Movesense HR2", "0C8CDC000001", "gatt_sensordata_app", "1.2.0")
    body = b"".join(text.encode() + b"\0" for text in texts)
    return bytes((ANSWER, reference, _PROTOCOL_VERSION)) + body


def parts(reference: int, payload: bytes, mtu: int) -> list[bytes]:
    """Split a packet into notifications."""
    room = min(mtu, FULL_MTU) - ATT_HEADER_BYTES - 2
    pieces = [payload[at : at + room] for at in range(0, len(payload), room)]
    codes = _PARTS + _PARTS[-1:] * len(pieces)
    return [bytes((code, reference)) + piece for code, piece in zip(codes, pieces, strict=False)]


def ecg(stamp_ms: int, microvolts: Floats, *, scaled: bool) -> tuple[bytes, Floats]:
    """Return an ECG packet, and the values in it [uV]."""
    unit, dtype, limit = (1.0, "<i2", 32767) if scaled else (COUNT_UV, "<i4", 1 << 23)
    counts = np.clip(np.rint(microvolts / unit), -limit, limit).astype(dtype)
    return _stamp(stamp_ms) + counts.tobytes(), counts * unit


def vectors(stamp_ms: int, arrays: list[Floats]) -> tuple[bytes, list[Floats]]:
    """Return a packet of consecutive vector arrays, and the values in it."""
    floats = [array.astype("<f4") for array in arrays]
    body = b"".join(each.tobytes() for each in floats)
    return _stamp(stamp_ms) + body, [each.astype(np.float64) for each in floats]


def heart_rate(bpm: float, interval_ms: int) -> bytes:
    """Return a packet with mean heart rate and one R-R interval."""
    return struct.pack("<fH", bpm, interval_ms)


def temperature(stamp_ms: int, kelvin: float) -> bytes:
    """Return a temperature packet."""
    return _stamp(stamp_ms) + struct.pack("<f", kelvin)


def damaged(rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Yield notifications that are not complete messages of any subscription."""
    for number in range(count):
        noise = rng.bytes(int(rng.integers(0, 18)))
        yield (b"\x02", bytes((9, 9)) + noise, bytes((2, 255)) + noise)[number % 3]


def _stamp(stamp_ms: int) -> bytes:
    return struct.pack("<I", stamp_ms & 0xFFFFFFFF)
