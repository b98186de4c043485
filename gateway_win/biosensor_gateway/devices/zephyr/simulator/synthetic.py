"""A wearer as the source of a virtual BioHarness's packets."""

from __future__ import annotations

import heapq
from datetime import date
from types import MappingProxyType
from typing import Unpack

import numpy as np

from biosensor_gateway.devices.zephyr.simulator import wire
from biosensor_gateway.devices.zephyr.simulator.inputs import BREATHING_SWING_COUNTS, Inputs
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing
from biosensor_gateway.devices.zephyr.simulator.vitals import Values, general, summary_v2
from biosensor_gateway.devices.zephyr.simulator.wire import (
    MS_PER_DAY,
    WAVEFORMS,
    DeviceStamp,
    Packet,
    duration_ms,
)
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.specimen import Specimen, SpecimenOptions
from biosensor_gateway.system.clock import Clock

DEFAULT_CLOCK = DeviceStamp(date(2026, 1, 30), 36_000_000)
_STAMP_JITTER_MS = 1
_GENERAL_WORN = 0x80
_GENERAL_HR_LOW = 0x20
_HRV_UNRELIABLE = 0x200
# Worn level 3 = none, and heart rate (bit 4) and respiration (bit 5) unreliable.
_NOT_WORN = 0x33


class SyntheticSource:
    """A device on a wearer; it measures whether or not a host listens.

    Sequence numbers, sample numbers and clock advance while nothing is sent, so
    that after a break exactly the samples of the missing packets are missing.

    Parameters
    ----------
    clock_start
        Reading of the device's clock at power-on.
    speed
        Device seconds in a second.
    hrv_after_s
        HRV is invalid until so long after power-on [device s].
    **specimen
        As for every virtual device: see `Specimen`. The jitter of the stamps comes from the
        seed, too.

    Attributes
    ----------
    battery_percent
        The battery's charge now.
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
        """Never: they are the conversation's."""
        return False

    def power_on(self, clock: Clock) -> None:
        """Set device time 0 to the clock's now."""
        self._crystal = Crystal(clock, self._crystal_ppm(self._drift_ppm))

    def power_cycle(self) -> None:
        """Begin anew with every number at 0; the clock has gone on."""
        self.step_clock(round(1000 * self._crystal.now()))
        self.power_on(self._crystal.clock)
        self._begin_measuring()

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        """Return events, then the enabled packets whose last sample is measured."""
        device_ms = 1000 * self._crystal.at(now)
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
        """Never."""
        del now
        return False

    def connection_ended(self) -> None:
        """Measure on: a device does not need a host for that."""

    def set_worn(self, *, worn: bool) -> None:
        """Put the strap on or off: status, confidence, vitals and event 0x1040.

        The waveforms stay what they are: pure functions of the sample number.
        """
        if worn != self._worn:
            self.add_event(0x1040, bytes((0, 100)) if worn else bytes((100, 0)))
        self._worn = worn

    def set_drift(self, ppm: float) -> None:
        """Run the crystal so much too fast from now on."""
        self._drift_ppm = ppm
        self._crystal.set_drift(self._crystal_ppm(ppm))

    def step_clock(self, milliseconds: int) -> None:
        """Set the device's clock forward (or back); measuring is not disturbed."""
        self._clock = self._clock.plus(milliseconds)

    def midnight_in(self, milliseconds: int) -> None:
        """Set the clock forward so that it turns midnight in so many device milliseconds."""
        ms_of_day = self._clock.plus(round(1000 * self._crystal.now())).ms_of_day
        self.step_clock(MS_PER_DAY - milliseconds - ms_of_day)

    def add_event(self, code: int, data: bytes) -> None:
        """Have an event happen at the next `poll`."""
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
        period_s = layout.period_ms / 1000 / (1 + self._crystal.drift_ppm * 1e-6)
        return Outgoing(data, packet, index, stamp, measured_at, period_s, first, samples)

    def _vitals(self, packet: Packet, t: float) -> Values:
        """Return what a summary or general data packet at ``t`` [device s] holds."""
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
        status = 0 if worn else _NOT_WORN
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
        return self._crystal.true_time(device_ms / 1000)

    def _crystal_ppm(self, drift_ppm: float) -> float:
        return 1e6 * (self._speed * (1 + drift_ppm * 1e-6) - 1)

    def _rng(self, packet: Packet, index: int, purpose: int) -> np.random.Generator:
        """Return the random numbers of one packet, the same whenever asked for."""
        return np.random.default_rng((self._seed, packet, index, purpose))
