"""The virtual BioHarness 3: steered by faults, with its truth in declared units."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from math import nan
from types import MappingProxyType
from typing import Any

import numpy as np
from pylsl import local_clock

from biosensor_gateway.devices.zephyr.simulator.bioharness import SimulatedBioHarness
from biosensor_gateway.devices.zephyr.simulator.body import CENTRE_COUNTS, COUNTS_PER_G, Integers
from biosensor_gateway.devices.zephyr.simulator.expected import EXPECTED
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing, SyntheticSource
from biosensor_gateway.devices.zephyr.simulator.vitals import Values
from biosensor_gateway.devices.zephyr.simulator.wire import REQUESTS, Packet
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World

_COUNTS_PER_G_100MG = 10.0
_UNREACHABLE = frozenset({FaultKind.DROP, FaultKind.RESTART})
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


class SimulatedZephyr(VirtualDevice):
    """A virtual BioHarness 3 on a pseudo-terminal, in a thread of its own.

    Its `truth` holds the streams of the packets that the host switched on. An interval
    (``ibi``) has the time of the R-to-R sample that shows it first; one that a host
    cannot see, since the sample before it was not sent, is not there.

    Parameters
    ----------
    world
        Where faults begin and end.
    wearer
        Only the mean rates of heart and respiration; the signals are the `Body`'s.
    seed
        Of signals, delays and garbage.
    drift_ppm, jitter_s
        Of the crystal, and the radio's longest delay.
    kept
        Limit of `truth`; None = all.
    """

    sensor = "zephyr"
    faults = frozenset(FaultKind)
    expected = EXPECTED

    def __init__(
        self,
        world: World,
        *,
        wearer: Wearer | None = None,
        seed: int = 0,
        drift_ppm: float = 0.0,
        jitter_s: float = 0.0,
        kept: int | None = None,
    ) -> None:
        super().__init__(world, kept)
        self.wearer = wearer or Wearer(seed)
        self._source = SyntheticSource(
            seed,
            heart_rate_bpm=self.wearer.heart_rate_bpm,
            respiration_rate_bpm=self.wearer.respiration_rate_bpm,
            drift_ppm=drift_ppm,
            jitter_s=jitter_s,
        )
        note = _Notes(self.truth).note
        self._device = SimulatedBioHarness(
            self._source, seed=seed, kept_packets=0, put_on_link=note
        )

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``port``."""
        return {"port": self._device.port}

    async def _start(self) -> None:
        self._device.start()

    async def _stop(self) -> None:
        self._device.stop()

    def _begin(self, fault: Fault) -> None:
        device, value = self._device, fault.value
        begin: Mapping[FaultKind, Callable[[], None]] = {
            FaultKind.DROP: device.drop_link,
            FaultKind.RESTART: device.drop_link,
            FaultKind.STALL: device.stall,
            FaultKind.GARBAGE: lambda: device.garbage(int(value)),
            FaultKind.FORGET: device.forget_enables,
            FaultKind.REFUSE: self._refuse,
            FaultKind.LATE: lambda: self._answer_late(value),
            FaultKind.LOW_BATTERY: lambda: device.battery(round(value)),
            FaultKind.OFF_BODY: device.off_body,
            FaultKind.DRIFT: lambda: device.carry_out(
                lambda: self._source.set_drift(value, time.monotonic())
            ),
        }
        begin[fault.kind]()

    def _end(self, kind: FaultKind) -> None:
        device = self._device
        end: Mapping[FaultKind, Callable[[], None]] = {
            FaultKind.DROP: self._restore,
            FaultKind.RESTART: self._power_on,
            FaultKind.STALL: device.resume,
            FaultKind.REFUSE: self._allow,
            FaultKind.LATE: lambda: device.delay_answers(0.0),
            FaultKind.OFF_BODY: device.on_body,
        }
        end[kind]()

    def _break_link(self) -> None:
        self._device.drop_link()
        self._restore()

    def _restore(self) -> None:
        if not _UNREACHABLE & self._lasting.keys():
            self._device.restore_link()

    def _power_on(self) -> None:
        self._device.carry_out(lambda: self._source.power_cycle(time.monotonic()))
        self._restore()

    def _refuse(self) -> None:
        for request_id in REQUESTS:
            self._device.refuse(request_id)
        self._break_link()

    def _allow(self) -> None:
        for request_id in REQUESTS:
            self._device.allow(request_id)

    def _answer_late(self, seconds: float) -> None:
        self._device.delay_answers(seconds)
        self._break_link()


class _Notes:
    """Writes frames into a truth; for one thread."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._offset_s = _lsl_offset()
        self._beat_before: tuple[int, int] | None = None

    def note(self, frame: Outgoing, sent: bool) -> None:
        """Note what a frame holds, as sent or as lost."""
        if frame.measured_at is None:
            return
        first_s = frame.measured_at + self._offset_s
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


def _lsl_offset() -> float:
    """Return what the LSL clock is ahead of the monotonic one [s]."""
    # Whatever comes between the two readings makes it too small.
    return max(local_clock() - time.monotonic() for _ in range(9))


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
