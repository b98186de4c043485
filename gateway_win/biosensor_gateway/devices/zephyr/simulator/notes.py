"""Notes in a truth what the frames of a virtual BioHarness hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan
from types import MappingProxyType

import numpy as np

from biosensor_gateway.devices.zephyr.simulator.inputs import CENTRE_COUNTS, COUNTS_PER_G, Integers
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing
from biosensor_gateway.devices.zephyr.simulator.vitals import Values
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.simulation.truth import Truth

_COUNTS_PER_G_100MG = 10.0
_WAVEFORMS: Mapping[Packet, str] = MappingProxyType(
    {
        Packet.ECG: "ecg",
        Packet.BREATHING: "breathing",
        Packet.ACCELERATION: "acc",
        Packet.ACCELERATION_100MG: "acc",
    }
)
_VITALS: Mapping[str, str] = MappingProxyType(
    {
        "hr": "heart_rate_bpm",
        "hrv": "hrv_ms",
        "br": "respiration_rate_bpm",
        "posture": "posture_deg",
        "activity": "activity_vmu_g",
        "st": "skin_temperature_c",
        "bat": "battery_percent",
        "rssi": "rssi_db",
    }
)
_WORN_LEVEL, _NOT_WORN = 0x3, 0x3
_HR_UNRELIABLE, _BR_UNRELIABLE, _HRV_UNRELIABLE = 1 << 4, 1 << 5, 1 << 9
_GENERAL_WORN, _GENERAL_HR_LOW = 0x80, 0x20


class Notes:
    """Writes frames into a truth.

    An interval (``ibi``) has the time of the R-to-R sample that shows it first; one that
    a host cannot see, since the sample before it was not sent, is not noted.

    Parameters
    ----------
    truth
        Takes samples in declared units.
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._beat_before: tuple[int, int] | None = None

    def note(self, frame: Outgoing, *, sent: bool) -> None:
        """Note what a frame holds, as sent or as lost."""
        first_s = frame.measured_at
        if first_s is None:
            return
        if frame.samples is not None:
            times = first_s + (frame.period_s or 0.0) * np.arange(len(frame.samples))
            self._waveform(frame, frame.samples, times.tolist(), sent=sent)
        elif frame.values is not None:
            values = _vitals(frame.values, general=frame.packet is Packet.GENERAL)
            for data_name, row in values.items():
                self._put(data_name, [first_s], [row], sent=sent)

    def _waveform(
        self, frame: Outgoing, samples: Integers, times: list[float], *, sent: bool
    ) -> None:
        if frame.packet is Packet.RR:
            if sent:  # how many beats a lost packet showed is not worth a guess
                self._intervals(frame.first_index or 0, samples[:, 0].tolist(), times)
        elif frame.packet is not None:
            rows = _scaled(frame.packet, samples)
            self._put(_WAVEFORMS[frame.packet], times, rows, sent=sent)

    def _intervals(self, first: int, values: list[int], times: list[float]) -> None:
        """Note the samples at which the sign turns: each beat turns it."""
        known = self._beat_before is not None and self._beat_before[0] == first - 1
        before = self._beat_before[1] if known and self._beat_before else values[0]
        for value, time_s in zip(values, times, strict=True):
            if (value < 0) != (before < 0):
                self._truth.sent("ibi", [time_s], [[abs(value) / 1000]])
            before = value
        self._beat_before = (first + len(values) - 1, before)

    def _put(
        self, data_name: str, times: list[float], rows: Sequence[Sequence[float]], *, sent: bool
    ) -> None:
        if sent:
            self._truth.sent(data_name, times, rows)
        else:
            self._truth.unsent(data_name, len(times))


def _scaled(packet: Packet, samples: Integers) -> list[list[float]]:
    if packet is Packet.ACCELERATION:
        scaled = (samples - CENTRE_COUNTS) / COUNTS_PER_G
    elif packet is Packet.ACCELERATION_100MG:
        scaled = samples / _COUNTS_PER_G_100MG
    else:
        scaled = samples.astype(np.float64)
    return [[float(value) for value in row] for row in scaled]


def _vitals(values: Values, *, general: bool) -> dict[str, list[float]]:
    """Return what a packet of vital signs says, by stream."""
    rows = {
        name: [float(value)]
        for name, field in _VITALS.items()
        if (value := values.get(field)) is not None
    }
    if general:
        flags = round(values["flags"] or 0)
        worn, low = bool(flags & _GENERAL_WORN), bool(flags & _GENERAL_HR_LOW)
        return rows | {"quality": [float(worn), nan, float(low), nan, nan, nan]}
    status = round(values["status_info"] or 0)
    unreliable = [
        float(bool(status & bit)) for bit in (_HR_UNRELIABLE, _BR_UNRELIABLE, _HRV_UNRELIABLE)
    ]
    worn = status & _WORN_LEVEL != _NOT_WORN
    confidence = _number(values.get("heart_rate_confidence"))
    link = _number(values.get("link_quality"))
    return rows | {"quality": [float(worn), confidence, *unreliable, link]}


def _number(value: float | None) -> float:
    return nan if value is None else float(value)
