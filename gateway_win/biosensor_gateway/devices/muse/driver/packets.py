"""Packets of headbands before the Athena; no I/O and no clock.

Each characteristic sends packets of 20 bytes: a number, then samples of one channel or of three
axes, all big-endian; the number counts the packets of its characteristic [1]_, [2]_.

.. [1] muse-lsl, `muse.py` and `constants.py`.
.. [2] muse-js, `muse-parse.ts`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

NUMBERS = 1 << 16
_BYTES, _NUMBER_BYTES = 20, 2
EEG_SAMPLES, LIGHT_SAMPLES, MOTION_SAMPLES = 12, 6, 3
EEG_UV = 2000 / 4096
"""Of a count: 12 bits hold 2 mV."""
EEG_ZERO = 2048
ACC_G = 1 / 16384
GYRO_DPS = 245 / 32768
"""245 degrees per second in 15 bits: the 0.0074768 of muse-lsl and muse-js."""
CHARGE_PERCENT = 1 / 512

Floats = NDArray[np.float64]

FULLEST_PERCENT = 105
"""A full battery says a little more than 100."""


class Packet(NamedTuple):
    """One packet.

    Attributes
    ----------
    number
        Counts packets of the characteristic, modulo `NUMBERS`.
    samples : ndarray of float64
        Shape (n,) of a channel, (n, 3) of axes.
    """

    number: int
    samples: Floats


def parse_eeg(data: bytes) -> Packet | None:
    """Read twelve samples of an electrode [uV]; None if it is no packet."""
    if len(data) != _BYTES:
        return None
    triples = np.frombuffer(data, np.uint8, offset=_NUMBER_BYTES).reshape(-1, 3).astype(np.int32)
    high = triples[:, 0] << 4 | triples[:, 1] >> 4
    low = (triples[:, 1] & 0xF) << 8 | triples[:, 2]
    counts = np.stack((high, low), axis=1).reshape(-1)
    return Packet(_number(data), (counts - EEG_ZERO).astype(np.float64) * EEG_UV)


def parse_light(data: bytes) -> Packet | None:
    """Read six samples of a photodiode [counts of 24 bits]; None if it is no packet."""
    if len(data) != _BYTES:
        return None
    triples = np.frombuffer(data, np.uint8, offset=_NUMBER_BYTES).reshape(-1, 3).astype(np.int32)
    counts = triples[:, 0] << 16 | triples[:, 1] << 8 | triples[:, 2]
    return Packet(_number(data), counts.astype(np.float64))


def parse_motion(data: bytes, unit: float) -> Packet | None:
    """Read three samples of X, Y, Z; None if it is no packet.

    Parameters
    ----------
    unit
        What a count is: `ACC_G` or `GYRO_DPS`.
    """
    if len(data) != _BYTES:
        return None
    counts = np.frombuffer(data, ">i2", offset=_NUMBER_BYTES).reshape(MOTION_SAMPLES, 3)
    return Packet(_number(data), counts * unit)


def parse_charge(data: bytes) -> float | None:
    """Read the battery's state of charge [percent] of a telemetry packet; None if it is none."""
    if len(data) != _BYTES:
        return None
    percent = int.from_bytes(data[2:4], "big") * CHARGE_PERCENT
    return min(100.0, percent) if percent <= FULLEST_PERCENT else None


def _number(data: bytes) -> int:
    return int.from_bytes(data[:_NUMBER_BYTES], "big")
