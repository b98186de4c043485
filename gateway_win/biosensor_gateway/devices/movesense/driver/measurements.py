"""Paths that can be asked of a device, the streams behind them, and the layout of their packets."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from biosensor_gateway.devices.movesense.driver.protocol import (
    ECG_SAMPLES,
    STAMP_BYTES,
    VECTOR_BYTES,
)

HELLO_REFERENCE = 1
"""The others are those of the measurements; none is 0."""
_ECG, _MOVEMENT, _HEART_RATE, _TEMPERATURE = 100, 99, 98, 97
_PACKETS_PER_SECOND = 13
"""Of movement, at all rates: 4 samples a packet at 52 Hz, 8 at 104 Hz."""
_SHARED = {
    frozenset({"acc"}): ("/Meas/Acc", ("acc",)),
    frozenset({"gyro"}): ("/Meas/Gyro", ("gyro",)),
    frozenset({"mag"}): ("/Meas/Magn", ("mag",)),
    frozenset({"acc", "gyro"}): ("/Meas/IMU6", ("acc", "gyro")),
    frozenset({"acc", "mag"}): ("/Meas/IMU6m", ("acc", "mag")),
}
_ALL = ("/Meas/IMU9", ("acc", "gyro", "mag"))
MOVEMENT = _ALL[1]
"""Data names of the streams that come from the movement sensor."""


class Measurement(NamedTuple):
    """One subscription; a device has room for four.

    Attributes
    ----------
    reference
        Which the device sends with its packets.
    streams
        Data names, in the order of the arrays in a packet.
    rate_hz
        Nominal; None where packets come when there is something.
    full_bytes
        How long a packet is likely to be; 0 where each is complete as it comes.
    sample_bytes
        Of all streams together.
    """

    reference: int
    path: str
    streams: tuple[str, ...]
    rate_hz: int | None = None
    full_bytes: int = 0
    sample_bytes: int = 1


HEART_RATE = Measurement(_HEART_RATE, "/Meas/HR", ("hr", "ibi"))
TEMPERATURE = Measurement(_TEMPERATURE, "/Meas/Temp", ("temp",))


def ecg(rate_hz: int, *, in_millivolts: bool) -> Measurement:
    """Return the measurement of the ECG, as counts or in what the device calls millivolts."""
    width = 2 if in_millivolts else 4
    path = f"/Meas/ECG/{rate_hz}" + ("/mV" if in_millivolts else "")
    full = STAMP_BYTES + width * ECG_SAMPLES
    return Measurement(_ECG, path, ("ecg",), rate_hz, full, width)


def movement(wanted: Collection[str], rate_hz: int) -> Measurement:
    """Return the measurement that has the wanted streams, all of them stamped together.

    Parameters
    ----------
    wanted
        Some of `MOVEMENT`.
    """
    path, streams = _SHARED.get(frozenset(wanted), _ALL)
    sample = VECTOR_BYTES * len(streams)
    full = STAMP_BYTES + rate_hz // _PACKETS_PER_SECOND * sample
    return Measurement(_MOVEMENT, f"{path}/{rate_hz}", streams, rate_hz, full, sample)
