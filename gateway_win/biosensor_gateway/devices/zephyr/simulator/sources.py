"""The sources of a virtual BioHarness' packets: a recording or a body.

A source knows neither link nor host. It is asked, with the host's monotonic time,
for the frames that are due.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date
from types import MappingProxyType
from typing import Protocol

from biosensor_gateway.devices.zephyr.simulator import wire
from biosensor_gateway.devices.zephyr.simulator.body import (
    BREATHING_SWING_COUNTS,
    Body,
    Integers,
)
from biosensor_gateway.devices.zephyr.simulator.pace import Pace
from biosensor_gateway.devices.zephyr.simulator.vitals import Values, general, summary_v2
from biosensor_gateway.devices.zephyr.simulator.wire import (
    MS_PER_DAY,
    WAVEFORMS,
    DeviceStamp,
    Packet,
    duration_ms,
)

DEFAULT_CLOCK = DeviceStamp(date(2026, 1, 30), 36_000_000)
_STAMP_JITTER_MS = 1
_GENERAL_WORN = 0x80
_GENERAL_HR_LOW = 0x20
_HRV_UNRELIABLE = 0x200
# Worn level 3 = none, and heart rate (bit 4) and respiration (bit 5) unreliable.
_NOT_WORN = 0x33


@dataclass(frozen=True, eq=False)
class Outgoing:
    """One frame of a source, with what it holds.

    Attributes
    ----------
    data
        The frame's bytes; for recorded junk whatever was there.
    packet
        Its kind; None for junk and message ids that the project does not know.
    sequence
        Packet number since power-on, not wrapped; the frame holds its low 8 bits.
    stamp
        The device's clock as the frame says it.
    measured_at
        When its first sample (or, for a summary, the whole) was measured, on the
        monotonic clock of this computer [s].
    period_s
        True time between two of its samples [s].
    first_index
        Number of its first sample since power-on.
    samples
        Shape (samples, channels); as `Body.samples` returns them.
    values
        Fields of a summary or general data packet.
    corrupted
        The device damaged the frame on its way: a host must not accept it.
    """

    data: bytes
    packet: Packet | None = None
    sequence: int | None = None
    stamp: DeviceStamp | None = None
    measured_at: float | None = None
    period_s: float | None = None
    first_index: int | None = None
    samples: Integers | None = None
    values: Values | None = None
    corrupted: bool = False


class Source(Protocol):
    """Gives frames when they are due; all times are monotonic seconds."""

    @property
    def speaks_lifesigns(self) -> bool:
        """Whether its frames include the device's lifesigns at present."""
        ...

    def power_on(self, now: float) -> None:
        """Begin to measure."""
        ...

    def poll(self, now: float, enabled: frozenset[Packet]) -> Iterable[Outgoing]:
        """Return the frames that became due; of periodic packets the enabled ones."""
        ...

    def next_due(self) -> float:
        """Return when `poll` is worth calling again."""
        ...

    def hangs_up(self, now: float) -> bool:
        """Tell whether the device ends the connection by itself."""
        ...

    def connection_ended(self) -> None:
        """Hear that the host is gone."""
        ...


class SyntheticSource:
    """A device on a `Body`; it measures whether or not a host listens.

    Sequence numbers, sample numbers and clock advance while nothing is sent, so
    that after a break exactly the samples of the missing packets are missing.

    Parameters
    ----------
    seed, heart_rate_bpm, respiration_rate_bpm, posture_deg
        Of the `Body`.
    clock_start
        Reading of the device's clock at power-on.
    drift_ppm
        How much faster than this computer's the device's crystal runs.
    jitter_s
        Packets leave up to so much later than they are complete (one-sided).
    speed
        Device seconds in a second.
    hrv_after_s
        HRV is invalid until so long after power-on [device s].
    worn, battery_percent
        State at power-on.
    """

    def __init__(
        self,
        seed: int = 0,
        *,
        heart_rate_bpm: float = 72.0,
        respiration_rate_bpm: float = 15.0,
        posture_deg: float = 10.0,
        clock_start: DeviceStamp = DEFAULT_CLOCK,
        drift_ppm: float = 0.0,
        jitter_s: float = 0.0,
        speed: float = 1.0,
        hrv_after_s: float = 300.0,
        worn: bool = True,
        battery_percent: int = 80,
    ) -> None:
        self.body = Body(seed, heart_rate_bpm, respiration_rate_bpm, posture_deg)
        self._clock = clock_start
        self._pace = Pace(speed, drift_ppm)
        self._jitter_ms = 1000 * jitter_s
        self._hrv_after_s = hrv_after_s
        self._worn = worn
        self._battery_percent = battery_percent
        self._begin_measuring()

    @property
    def speaks_lifesigns(self) -> bool:
        """Never: they are the conversation's."""
        return False

    def power_on(self, now: float) -> None:
        """Set device time 0 to ``now``."""
        self._pace.start(now)

    def power_cycle(self, now: float) -> None:
        """Begin anew with every number at 0; the clock has gone on."""
        self.step_clock(round(self._pace.device_ms(now)))
        self.power_on(now)
        self._begin_measuring()

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        """Return events, then the enabled packets whose last sample is measured."""
        device_ms = self._pace.device_ms(now)
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
        return self._pace.true_s(self._queue[0][0])

    def hangs_up(self, now: float) -> bool:
        """Never."""
        del now
        return False

    def connection_ended(self) -> None:
        """Measure on: a device does not need a host for that."""

    def set_worn(self, worn: bool) -> None:
        """Put the strap on or off: status, confidence, vitals and event 0x1040.

        The waveforms stay what they are: pure functions of the sample number.
        """
        if worn != self._worn:
            self.add_event(0x1040, bytes((0, 100)) if worn else bytes((100, 0)))
        self._worn = worn

    def set_drift(self, ppm: float, now: float) -> None:
        """Run the crystal so much too fast from ``now`` on."""
        self._pace.set_drift(ppm, now)

    def set_battery(self, percent: int) -> None:
        """Set the battery's charge [percent]."""
        self._battery_percent = percent

    def step_clock(self, milliseconds: int) -> None:
        """Set the device's clock forward (or back); measuring is not disturbed."""
        self._clock = self._clock.plus(milliseconds)

    def midnight_in(self, milliseconds: int, now: float) -> None:
        """Set the clock forward so that it turns midnight in so many device milliseconds."""
        ms_of_day = self._clock.plus(round(self._pace.device_ms(now))).ms_of_day
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
        late_ms = self.body.rng(packet, index, 1).uniform(0, 1) * self._jitter_ms
        return (index + 1) * duration_ms(packet) + late_ms

    def _event(self, code: int, data: bytes, device_ms: float) -> Outgoing:
        stamp, sequence = self._clock.plus(round(device_ms)), self._event_count
        self._event_count += 1
        data = wire.event(sequence, stamp, code, data)
        return Outgoing(data, Packet.EVENT, sequence, stamp, self._pace.true_s(device_ms))

    def _packet(self, packet: Packet, index: int) -> Outgoing:
        is_waveform = packet in WAVEFORMS
        begin_ms = (index if is_waveform else index + 1) * duration_ms(packet)
        jitter = self.body.rng(packet, index, 2).integers(-_STAMP_JITTER_MS, _STAMP_JITTER_MS + 1)
        stamp = self._clock.plus(begin_ms + int(jitter))
        measured_at = self._pace.true_s(begin_ms)
        if not is_waveform:
            values = self._vitals(packet, begin_ms / 1000)
            encode = summary_v2 if packet is Packet.SUMMARY else general
            data = encode(index, stamp, values)
            return Outgoing(data, packet, index, stamp, measured_at, values=values)
        samples = self.body.samples(packet, index)
        data = wire.waveform(packet, index, stamp, [int(value) for value in samples.flat])
        layout = WAVEFORMS[packet]
        period_s, first = layout.period_ms / 1000 / self._pace.rate, index * layout.samples
        return Outgoing(data, packet, index, stamp, measured_at, period_s, first, samples)

    def _vitals(self, packet: Packet, t: float) -> Values:
        """Return what a summary or general data packet at ``t`` [device s] holds."""
        worn = self._worn
        shared: dict[str, float | None] = {
            "heart_rate_bpm": round(self.body.heart_rate_at(t)) if worn else None,
            "respiration_rate_bpm": round(self.body.respiration_rate_bpm, 1) if worn else None,
            "posture_deg": round(self.body.posture_deg),
            "activity_vmu_g": 0.05,
            "peak_accel_g": 0.09,
            "battery_v": round(3.5 + 0.007 * self._battery_percent, 3),
            "battery_percent": self._battery_percent,
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
            "hrv_ms": round(self.body.sdnn_ms(t)) if hrv_is_valid else None,
            "system_confidence": 100 if worn else 0,
            "rog": 1 if worn else 0,
            "device_temperature_c": 30.0,
            "status_info": status if hrv_is_valid else status | _HRV_UNRELIABLE,
            "link_quality": 254,
            "rssi_db": -24,
            "tx_power_dbm": 12,
            "core_temperature_c": 37.1 if worn else None,
        }
