"""The virtual BioHarness 3 on a wearer, with every fault and its truth in declared units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from math import nan
from types import MappingProxyType
from typing import Unpack

import numpy as np

from biosensor_gateway.devices.zephyr.simulator.bioharness import BioHarness
from biosensor_gateway.devices.zephyr.simulator.inputs import CENTRE_COUNTS, COUNTS_PER_G, Integers
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing
from biosensor_gateway.devices.zephyr.simulator.synthetic import SyntheticSource
from biosensor_gateway.devices.zephyr.simulator.vitals import Values
from biosensor_gateway.devices.zephyr.simulator.wire import REQUESTS, Packet
from biosensor_gateway.simulation.effects import Effect, lasting
from biosensor_gateway.simulation.expected import Expected, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.specimen import SpecimenOptions
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.world import World

EXPECTED = Expected(
    without_contact=("hr", "br"),
    by_agent=frozenset({"quality"}),
    # Packets are numbered and stamped; after a restart it measures between two of them.
    loss_tolerance=LossTolerance(over_restart={"ecg": 63, "breathing": 18, "acc": 20}),
)

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


class _Notes:
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


_DENIABLE = (0x16, 0x1E, 0x19, 0x15)
"""Requests for ECG, acceleration, intervals and breathing; one is denied at each time."""


class SimulatedZephyr(BioHarness):
    """A BioHarness 3 that somebody wears.

    Its `truth` holds the streams of the packets that the host switched on.

    Parameters
    ----------
    world
        Where it lives.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    expected = EXPECTED

    def __init__(self, world: World, **specimen: Unpack[SpecimenOptions]) -> None:
        self._body = SyntheticSource(**specimen)
        super().__init__(world, self._body, **specimen)
        self._notes = _Notes(self.truth)
        self._to_deny, self._denied = cycle(_DENIABLE), 0

    def _note(self, frame: Outgoing, *, sent: bool) -> None:
        self._notes.note(frame, sent=sent)

    def _go_down(self) -> None:
        self._hang_up()

    def _come_up(self) -> None:
        self._body.power_cycle()
        self._reopen()

    def _break_link(self) -> None:
        self._hang_up()
        self._reopen()

    def _forget(self, _: float) -> None:
        self.session.forget_enables()

    def _refuse(self) -> None:
        self.session.refused.update(REQUESTS)
        self._break_link()

    def _allow(self) -> None:
        self.session.refused.difference_update(REQUESTS)

    def _deny(self) -> None:
        self._denied = next(self._to_deny)
        self.session.refused.add(self._denied)
        self._break_link()

    def _give(self) -> None:
        self.session.refused.discard(self._denied)

    def _answer_late(self, seconds: float) -> None:
        self.session.answer_delay_s = seconds
        self._break_link()

    def _answer_in_time(self) -> None:
        self.session.answer_delay_s = 0.0

    def _take_off(self) -> None:
        self._body.set_worn(worn=False)

    def _put_on(self) -> None:
        self._body.set_worn(worn=True)

    def _discharge(self, percent: float) -> None:
        self._body.battery_percent = round(percent)

    def _drift(self, ppm: float) -> None:
        self._body.set_drift(ppm)

    effects = MappingProxyType(
        {
            **BioHarness.effects,
            FaultKind.RESTART: lasting(_go_down, _come_up),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: lasting(_refuse, _allow),
            FaultKind.DENY: lasting(_deny, _give),
            FaultKind.LATE: Effect(_answer_late, _answer_in_time),
            FaultKind.OFF_BODY: lasting(_take_off, _put_on),
            FaultKind.LOW_BATTERY: Effect(_discharge),
            FaultKind.DRIFT: Effect(_drift),
        }
    )
