"""A virtual BioHarness 3 on a wearer, with all faults and a truth in declared units."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from itertools import cycle
from math import atan2, degrees, nan
from types import MappingProxyType
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator import wire
from biosensor_gateway.devices.zephyr.simulator.bioharness import BioHarness, Integers, Outgoing
from biosensor_gateway.devices.zephyr.simulator.wire import (
    MS_PER_DAY,
    REQUESTS,
    WAVEFORMS,
    DeviceStamp,
    Packet,
    Values,
    duration_ms,
    frame,
    general,
    summary_v2,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.truth import ONE_RATE, Expected, LossTolerance, Truth
from biosensor_gateway.simulation.virtual_device import Specimen, SpecimenOptions
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import Oscillator, World
from biosensor_gateway.system.clock import Clock

CENTRE_COUNTS = 512
COUNTS_PER_G = 20.75
BREATHING_SWING_COUNTS = 60
SDNN_WINDOW_BEATS = 300

_MAX_COUNTS = 1023
_COUNTS = frozenset({Packet.ECG, Packet.BREATHING, Packet.ACCELERATION})
_UV_PER_COUNT = 8.0
# The signal swings by `BREATHING_SWING_COUNTS` for a force of 12 N +- 3 N.
_RESTING_FORCE_N, _COUNTS_PER_N = 12.0, BREATHING_SWING_COUNTS / 3
# Standard deviations in the packets' own units; intervals are exact.
_CONVERTER_NOISE: Mapping[Packet, float] = MappingProxyType(
    {
        Packet.ECG: 0.5,
        Packet.BREATHING: 0.5,
        Packet.RR: 0.0,
        Packet.ACCELERATION: 0.4,
    }
)

Floats = NDArray[np.float64]


class Inputs:
    """The wearer's signals in ADC counts."""

    def __init__(self, wearer: Wearer) -> None:
        self._wearer = wearer

    def samples(self, packet: Packet, index: int) -> Integers:
        """Return the samples of the ``index``-th packet of a waveform kind.

        Returns
        -------
        ndarray of int64, shape (samples, channels)
            10-bit counts (centre 512), or signed ms for R-to-R.
        """
        layout = WAVEFORMS[packet]
        position = index * layout.samples + np.arange(layout.samples)
        t = np.asarray(position * (layout.period_ms / 1000), np.float64)
        signals: Mapping[Packet, Callable[[Floats], Floats]] = {
            Packet.ECG: self._ecg,
            Packet.BREATHING: self._breathing,
            Packet.RR: self._rr,
            Packet.ACCELERATION: self._acceleration,
        }
        values = signals[packet](t).reshape(layout.samples, layout.channels)
        rng = np.random.default_rng((self._wearer.seed, packet, index))
        values = values + rng.normal(0, _CONVERTER_NOISE[packet], values.shape)
        if packet in _COUNTS:
            values = np.clip(values, 0, _MAX_COUNTS)
        return np.rint(values).astype(np.int64)

    @property
    def respiration_rate_bpm(self) -> float:
        """The respiration rate in 0.1 / min."""
        return round(self._wearer.respiration_rate_bpm, 1)

    def heart_rate_bpm(self, t: float) -> int:
        """Return the momentary heart rate at ``t`` [s] in 1/min."""
        return round(self._wearer.heart_rate(_one(t))[0])

    def sdnn_ms(self, t: float) -> int:
        """Return the standard deviation of the last 300 beat intervals at ``t`` [ms]."""
        last = np.floor(self._wearer.beat_count(_one(t)))[0]
        beats = last - np.arange(SDNN_WINDOW_BEATS, -1, -1, dtype=np.float64)
        return round(np.std(np.diff(self._wearer.beat_time(beats)), ddof=1) * 1000)

    def posture_deg(self, t: float) -> int:
        """Return the forward lean at ``t`` [s] in degrees, 0 = upright."""
        vertical, _, sagittal = self._wearer.acceleration_g(_one(t))[0]
        return round(degrees(atan2(sagittal, -vertical)))

    def _ecg(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + self._wearer.ecg_uv(t) / _UV_PER_COUNT

    def _breathing(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + _COUNTS_PER_N * (self._wearer.chest_force_n(t) - _RESTING_FORCE_N)

    def _rr(self, t: Floats) -> Floats:
        beat = np.floor(self._wearer.beat_count(t))
        interval_ms = np.rint(1000 * self._wearer.rr_before(self._wearer.beat_time(beat)))
        return np.where(beat % 2 == 0, interval_ms, -interval_ms)

    def _acceleration(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + COUNTS_PER_G * self._wearer.acceleration_g(t)


def _one(t: float) -> Floats:
    return np.array([t], np.float64)


DEFAULT_CLOCK = DeviceStamp(date(2026, 1, 30), 36_000_000)
_STAMP_JITTER_MS = 1
# Worn level 3 = none, and heart rate (bit 4) and respiration (bit 5) unreliable.
_STATUS_NOT_WORN = 0x33


class SyntheticSource:
    """A device on a wearer, which always measures.

    Sequence numbers, sample numbers and clock advance even while nothing is sent, so after a break
    exactly the samples of the lost packets are missing.

    Parameters
    ----------
    clock_start
        Time of the device's clock at power-on.
    speed
        Device seconds per second.
    hrv_after_s
        Time after power-on until HRV is valid [device s].
    **specimen
        As for every virtual device: see `Specimen`. The seed also determines the jitter of
        timestamps.
    """

    def __init__(
        self,
        *,
        clock_start: DeviceStamp = DEFAULT_CLOCK,
        speed: float = 1.0,
        hrv_after_s: float = 300.0,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        own = Specimen(**specimen)
        self.battery_percent = 80
        self._seed = own.seed
        self._inputs = Inputs(own.wearer)
        self._clock = clock_start
        self._speed = speed
        self._drift_ppm = own.drift_ppm
        self._jitter_ms = 1000 * own.jitter_s
        self._hrv_after_s = hrv_after_s
        self._worn = True
        self._begin_measuring()

    @property
    def speaks_lifesigns(self) -> bool:
        """False, because the session sends lifesigns."""
        return False

    def power_on(self, clock: Clock) -> None:
        """Start device time at 0 now."""
        self._oscillator = Oscillator(clock, self._oscillator_ppm(self._drift_ppm))

    def power_cycle(self) -> None:
        """Switch it off and on: its counters restart at 0, its clock goes on."""
        self.step_clock(round(1000 * self._oscillator.now()))
        self.power_on(self._oscillator.clock)
        self._begin_measuring()

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        """Return events, then the enabled packets whose last sample was measured."""
        device_ms = 1000 * self._oscillator.at(now)
        frames = [self._event(code, data, device_ms) for code, data in self._events]
        self._events.clear()
        while self._queue[0][0] <= device_ms:
            due_ms, packet, index = self._queue[0]
            next_due_ms = max(due_ms, self._due_ms(packet, index + 1))
            heapq.heapreplace(self._queue, (next_due_ms, packet, index + 1))
            if packet in enabled:
                frames.append(self._packet(packet, index))
        return frames

    def next_due(self) -> float:
        """Return when the next packet is complete, enabled or not."""
        return self._true_s(self._queue[0][0])

    def hangs_up(self, now: float) -> bool:
        """Return False, because the device never disconnects."""
        del now
        return False

    def connection_ended(self) -> None:
        """Do nothing, because the device measures without a host."""

    def set_worn(self, *, worn: bool) -> None:
        """Put the strap on or take it off, which changes status and vitals and sends event 0x1040.

        The waveforms do not change, because they only depend on the sample number.
        """
        if worn != self._worn:
            self.add_event(0x1040, bytes((0, 100)) if worn else bytes((100, 0)))
        self._worn = worn

    def set_drift(self, ppm: float) -> None:
        """Let the oscillator run too fast from now on."""
        self._drift_ppm = ppm
        self._oscillator.set_drift(self._oscillator_ppm(ppm))

    def step_clock(self, milliseconds: int) -> None:
        """Set the device's clock forward or back; the measurement continues."""
        self._clock = self._clock.plus(milliseconds)

    def midnight_in(self, milliseconds: int) -> None:
        """Set the clock forward so that midnight is in this many device milliseconds."""
        ms_of_day = self._clock.plus(round(1000 * self._oscillator.now())).ms_of_day
        self.step_clock(MS_PER_DAY - milliseconds - ms_of_day)

    def add_event(self, code: int, data: bytes) -> None:
        """Add an event for the next `poll`."""
        self._events.append((code, data))

    def _begin_measuring(self) -> None:
        self._events: list[tuple[int, bytes]] = []
        self._event_count = 0
        kinds = (*WAVEFORMS, Packet.SUMMARY, Packet.GENERAL)
        self._queue = [(self._due_ms(kind, 0), kind, 0) for kind in kinds]
        heapq.heapify(self._queue)

    def _due_ms(self, packet: Packet, index: int) -> float:
        late_ms = self._rng(packet, index, 1).uniform(0, 1) * self._jitter_ms
        return (index + 1) * duration_ms(packet) + late_ms

    def _event(self, code: int, data: bytes, device_ms: float) -> Outgoing:
        stamp, sequence = self._clock.plus(round(device_ms)), self._event_count
        self._event_count += 1
        data = wire.event(sequence, stamp, code, data)
        return Outgoing(data, Packet.EVENT, sequence, stamp, self._true_s(device_ms))

    def _packet(self, packet: Packet, index: int) -> Outgoing:
        is_waveform = packet in WAVEFORMS
        begin_ms = (index if is_waveform else index + 1) * duration_ms(packet)
        jitter = self._rng(packet, index, 2).integers(-_STAMP_JITTER_MS, _STAMP_JITTER_MS + 1)
        stamp = self._clock.plus(begin_ms + int(jitter))
        measured_at = self._true_s(begin_ms)
        if not is_waveform:
            values = self._vitals(packet, begin_ms / 1000)
            encode = summary_v2 if packet is Packet.SUMMARY else general
            data = encode(index, stamp, values)
            return Outgoing(data, packet, index, stamp, measured_at, values=values)
        samples = self._inputs.samples(packet, index)
        data = wire.waveform(packet, index, stamp, [int(value) for value in samples.flat])
        layout = WAVEFORMS[packet]
        first = index * layout.samples
        period_s = layout.period_ms / 1000 / (1 + self._oscillator.drift_ppm * 1e-6)
        return Outgoing(data, packet, index, stamp, measured_at, period_s, first, samples)

    def _vitals(self, packet: Packet, t: float) -> Values:
        """Return the values of a summary or general data packet at ``t`` [device s]."""
        worn = self._worn
        shared: dict[str, float | None] = {
            "heart_rate_bpm": self._inputs.heart_rate_bpm(t) if worn else None,
            "respiration_rate_bpm": self._inputs.respiration_rate_bpm if worn else None,
            "posture_deg": self._inputs.posture_deg(t),
            "activity_vmu_g": 0.05,
            "peak_accel_g": 0.09,
            "battery_v": round(3.5 + 0.007 * self.battery_percent, 3),
            "battery_percent": self.battery_percent,
            "breathing_wave_amplitude": 2 * BREATHING_SWING_COUNTS,
            "ecg_amplitude_v": 0.0018 if worn else 0.0,
            "ecg_noise_v": 0.00002,
        }
        return MappingProxyType(shared | self._extras(packet, t))

    def _extras(self, packet: Packet, t: float) -> dict[str, float | None]:
        worn = self._worn
        if packet is Packet.GENERAL:
            return {"rog": 1 if worn else 0, "flags": _GENERAL_WORN if worn else _GENERAL_HR_LOW}
        hrv_is_valid = worn and t >= self._hrv_after_s
        status = 0 if worn else _STATUS_NOT_WORN
        return {
            "heart_rate_confidence": 100 if worn else 0,
            "hrv_ms": self._inputs.sdnn_ms(t) if hrv_is_valid else None,
            "system_confidence": 100 if worn else 0,
            "rog": 1 if worn else 0,
            "device_temperature_c": 30.0,
            "status_info": status if hrv_is_valid else status | _HRV_UNRELIABLE,
            "link_quality": 254,
            "rssi_db": -24,
            "tx_power_dbm": 12,
            "core_temperature_c": 37.1 if worn else None,
        }

    def _true_s(self, device_ms: float) -> float:
        return self._oscillator.true_time(device_ms / 1000)

    def _oscillator_ppm(self, drift_ppm: float) -> float:
        return 1e6 * (self._speed * (1 + drift_ppm * 1e-6) - 1)

    def _rng(self, packet: Packet, index: int, purpose: int) -> np.random.Generator:
        """Return the random generator of one packet, which is always the same."""
        return np.random.default_rng((self._seed, packet, index, purpose))


EXPECTED = Expected(
    without_contact=("hr", "br"),
    by_agent=frozenset({"quality"}),
    # Packets have numbers and timestamps; after a restart, the measurement starts between two.
    impossible={
        FaultKind.REPEAT: "the sign of an interval shows whether it is new",
        Untidiness.RATE: ONE_RATE,
    },
    loss_tolerance=LossTolerance(over_restart={"ecg": 63, "breathing": 18, "acc": 20}),
)

_WAVEFORMS: Mapping[Packet, str] = MappingProxyType(
    {
        Packet.ECG: "ecg",
        Packet.BREATHING: "breathing",
        Packet.ACCELERATION: "acc",
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
    """Records frames in the truth.

    An interval (``ibi``) has the time of the first R-to-R sample that shows it; one that a host
    cannot detect, because the previous sample was not sent, is not recorded.

    Parameters
    ----------
    truth
        Takes samples in declared units.
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._beat_before: tuple[int, int] | None = None

    def note(self, frame: Outgoing, *, sent: bool) -> None:
        """Record the samples of a frame as sent or lost."""
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
            if sent:  # beats in lost packets are not counted
                self._intervals(frame.first_index or 0, samples[:, 0].tolist(), times)
        elif frame.packet is not None:
            rows = _scaled(frame.packet, samples)
            self._put(_WAVEFORMS[frame.packet], times, rows, sent=sent)

    def _intervals(self, first: int, values: list[int], times: list[float]) -> None:
        """Record the samples at which the sign changes, as it does with each beat."""
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
    else:
        scaled = samples.astype(np.float64)
    return [[float(value) for value in row] for row in scaled]


def _vitals(values: Values, *, general: bool) -> dict[str, list[float]]:
    """Return the values of a vital signs packet by data name."""
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


# Message id of a Zephyr HxM, which has a similar protocol.
_UNKNOWN_PACKET = 0x26
# Requests for ECG, acceleration, intervals and breathing, denied one at a time.
_DENIABLE = (0x16, 0x1E, 0x19, 0x15)


class SimulatedZephyr(BioHarness):
    """A BioHarness 3 on a wearer.

    Its `truth` contains the streams of the enabled packets.
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

    def _send_unknown(self, count: float) -> None:
        for _ in range(int(count)):
            self._write(frame(_UNKNOWN_PACKET, bytes(55)))

    def _give(self) -> None:
        self.session.refused.discard(self._denied)

    def _take_off(self) -> None:
        self._body.set_worn(worn=False)

    def _put_on(self) -> None:
        self._body.set_worn(worn=True)

    effects = MappingProxyType(
        {
            **BioHarness.effects,
            FaultKind.RESTART: lasting(_go_down, _come_up),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: lasting(_refuse, _allow),
            FaultKind.DENY: lasting(_deny, _give),
            Untidiness.STRAY: Effect(_send_unknown),
            FaultKind.LATE: level("session.answer_delay_s", 0.0, then=_break_link),
            FaultKind.OFF_BODY: lasting(_take_off, _put_on),
            FaultKind.LOW_BATTERY: level("_body.battery_percent", read=round),
            **on_part("_body", {FaultKind.DRIFT: Effect(SyntheticSource.set_drift)}),
        }
    )
