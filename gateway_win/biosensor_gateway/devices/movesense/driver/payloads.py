"""Payloads of measurements: bytes in, physical units out; no I/O and no clock.

Arrays have no length of their own, they fill the payload. Where there are several, they are
equally long and stand one behind the other, not interleaved. The layouts are those that
Movesense's example programs read [1]_ and that others found on hardware [2]_.

.. [1] Movesense device library, samples/gatt_sensordata_app, Python and iOS clients.
.. [2] What the documentation calls millivolts are whole microvolts: samples that came on both
   paths at a time had the ratio 0.38147.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.standard_topics import STANDARD_GRAVITY

STAMP_BYTES = 4
VECTOR_BYTES = 12
ECG_SAMPLES = 16
"""Of a packet, at all rates."""
MICROVOLTS_PER_COUNT = 0.381469726563
_ABSOLUTE_ZERO_C = -273.15
_FASTEST_BPM, _HOTTEST_K = 500.0, 1000.0
_ECG_TYPES = {4: np.dtype("<i4"), 2: np.dtype("<i2")}
_MICROVOLTS = {4: MICROVOLTS_PER_COUNT, 2: 1.0}

Floats = NDArray[np.float64]


class Block(NamedTuple):
    """Samples of one packet.

    Attributes
    ----------
    stamp_ms
        Device clock at the first one, in ms since it was switched on, modulo 2**32.
    samples : array, shape (n_streams, n_samples, n_channels)
        Of each stream that shares the packet.
    """

    stamp_ms: int
    samples: Floats


class HeartRate(NamedTuple):
    """Mean heart rate [1/min], 0 if there is none, and R-R intervals [ms], oldest first."""

    bpm: float
    intervals_ms: tuple[int, ...]


def parse_ecg(payload: bytes, width: int) -> Block | None:
    """Read a packet of ECG [uV]; None if it is cut short.

    Parameters
    ----------
    payload
    width
        Bytes a sample: 4 for counts, 2 for microvolts. A packet that has as many samples as it
        always has tells its width by itself.
    """
    body = payload[STAMP_BYTES:]
    width = len(body) // ECG_SAMPLES if len(body) in (2 * ECG_SAMPLES, 4 * ECG_SAMPLES) else width
    if not body or len(body) % width:
        return None
    counts = np.frombuffer(body, _ECG_TYPES[width])
    microvolts = counts.astype(np.float64) * _MICROVOLTS[width]
    return Block(_stamp(payload), microvolts.reshape(1, -1, 1))


def parse_vectors(payload: bytes, streams: int) -> Block | None:
    """Read a packet of vectors of so many streams; None if it is cut short or has no numbers."""
    body = payload[STAMP_BYTES:]
    if not body or len(body) % (VECTOR_BYTES * streams):
        return None
    numbers = np.frombuffer(body, "<f4")
    # Some that are no numbers cannot even be turned into float64 without a warning.
    if not np.isfinite(numbers).all():
        return None
    return Block(_stamp(payload), numbers.astype(np.float64).reshape(streams, -1, 3))


def parse_heart_rate(payload: bytes) -> HeartRate | None:
    """Read a heart rate; None if it is cut short or makes no sense. It has no stamp."""
    if len(payload) < 4 or len(payload) % 2:
        return None
    (bpm,) = np.frombuffer(payload[:4], "<f4").tolist()
    intervals = np.frombuffer(payload[4:], "<u2").tolist()
    return HeartRate(bpm, tuple(intervals)) if 0 <= bpm <= _FASTEST_BPM else None


def parse_temperature(payload: bytes) -> tuple[int, float] | None:
    """Read a temperature: its stamp [ms], and degrees Celsius; None if it makes no sense."""
    if len(payload) != STAMP_BYTES + 4:
        return None
    (kelvin,) = np.frombuffer(payload[STAMP_BYTES:], "<f4").tolist()
    return (_stamp(payload), kelvin + _ABSOLUTE_ZERO_C) if 0 < kelvin < _HOTTEST_K else None


def in_g(metres_per_second_squared: Floats) -> Floats:
    """Turn accelerations as the device sends them into g."""
    return metres_per_second_squared / STANDARD_GRAVITY


def _stamp(payload: bytes) -> int:
    return int.from_bytes(payload[:STAMP_BYTES], "little")
