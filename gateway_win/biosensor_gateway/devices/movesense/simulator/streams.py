"""One running measurement: samples of the wearer, in packets, at the device's pace."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from biosensor_gateway.devices.ble_heart_rate.simulator.heart import BeatDetector
from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import RR_TICKS_PER_S
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.devices.movesense.simulator import wire
from biosensor_gateway.devices.movesense.simulator.wire import Resource
from biosensor_gateway.simulation.wearer import Floats, Wearer

_PACKETS_PER_SECOND = 13
_OPEN_ELECTRODES_UV = 30.0
_DETECTION_PERIOD_S = 0.25
_TEMPERATURE_PERIOD_S = 1.0
_ABSOLUTE_ZERO_C = -273.15
# Of the earth, as the device lies on the chest [uT].
_FIELD_UT = np.array([18.0, -2.0, 42.0])


class Pipe(Protocol):
    """Sends the packets of one subscription."""

    async def __call__(self, payload: bytes) -> bool:
        """Send a packet; False if the host does not get all of it, or cannot read it."""
        ...


class MeasurementStream(Protocol):
    """A measurement that is on."""

    async def run(self) -> None:
        """Measure and send for ever."""
        ...

    def end(self) -> None:
        """Account for what was measured and not sent, once `run` is cancelled."""
        ...


class SampledStream:
    """Samples at a constant rate: ECG, or vectors that are measured together.

    Parameters
    ----------
    strap
        Who measures.
    deviation
        By which share the true rate is above the nominal one.
    """

    def __init__(self, strap: Strap, resource: Resource, send: Pipe, deviation: float) -> None:
        self._strap = strap
        self._oscillator = strap.oscillator
        self._resource = resource
        self._send = send
        self._rate_hz = resource.rate_hz * (1 + deviation)
        self._begin_s = strap.oscillator.now()
        self._next = 0
        is_ecg = resource.kind == "ecg"
        self._names = ("ecg",) if is_ecg else wire.VECTORS[resource.kind]
        self._count = wire.ECG_SAMPLES if is_ecg else resource.rate_hz // _PACKETS_PER_SECOND

    async def run(self) -> None:
        """Measure and send for ever."""
        while True:
            await self._oscillator.reach(self._device_s(self._next + self._count - 1))
            first_s = self._device_s(self._next)
            indices = range(self._next, self._next + self._count)
            times = np.array([self._oscillator.true_time(self._device_s(each)) for each in indices])
            payload, values = self._packet(round(1000 * first_s), times)
            sent = await self._send(payload)
            self._next += self._count
            for name, rows in zip(self._names, values, strict=True):
                self._note(name, times, rows, sent=sent)

    def end(self) -> None:
        """Account for the packet that was begun."""
        measured = int((self._oscillator.now() - self._begin_s) * self._rate_hz) + 1
        for name in self._names:
            self._strap.truth.unsent(name, max(0, measured - self._next))

    def _packet(self, stamp_ms: int, times: Floats) -> tuple[bytes, list[Floats]]:
        """Return the bytes, and the samples in units of the declaration."""
        t = times - self._strap.origin_s
        wearer, worn = self._strap.wearer, self._strap.worn
        if self._resource.kind == "ecg":
            open_circuit = wearer.noise(t, _OPEN_ELECTRODES_UV, "electrodes")
            microvolts = wearer.ecg_uv(t) if worn else open_circuit
            payload, held = wire.ecg(stamp_ms, microvolts, scaled=self._resource.scaled)
            return payload, [held[:, np.newaxis]]
        units = {"acc": wire.GRAVITY, "gyro": 1.0, "mag": 1.0}
        measured = [_vectors(wearer, name, t) * units[name] for name in self._names]
        payload, arrays = wire.vectors(stamp_ms, measured)
        return payload, [
            array / units[name] for name, array in zip(self._names, arrays, strict=True)
        ]

    def _note(self, name: str, times: Floats, rows: Floats, *, sent: bool) -> None:
        if sent:
            self._strap.truth.sent(name, times.tolist(), rows.tolist())
        elif self._strap.peripheral.connected:
            self._strap.truth.unsent(name, len(times))

    def _device_s(self, index: int) -> float:
        return self._begin_s + index / self._rate_hz


class HeartRateStream:
    """Mean heart rate and R-R interval, with each beat; it has no stamp."""

    def __init__(self, strap: Strap, send: Pipe) -> None:
        self._strap = strap
        self._send = send
        now_s = strap.oscillator.clock()
        self._detector = BeatDetector(strap.wearer, strap.oscillator, strap.origin_s, now_s)

    async def run(self) -> None:
        """Look for beats and send them for ever."""
        oscillator = self._strap.oscillator
        device_s = oscillator.now()
        while True:
            device_s += _DETECTION_PERIOD_S
            until_s = await oscillator.reach(device_s)
            if not self._strap.worn:
                self._detector.lose(until_s)
                continue
            for interval in self._detector.search(until_s):
                length_ms = round(1000 * interval.rr / RR_TICKS_PER_S)
                bpm = float(self._detector.bpm)
                if await self._send(wire.heart_rate(bpm, length_ms)):
                    self._strap.truth.sent("hr", [until_s], [(bpm,)])
                    self._strap.truth.sent("ibi", [interval.time], [(length_ms / 1000,)])

    def end(self) -> None:
        """Nothing is missing: the next beat is told by the next subscription."""


class TemperatureStream:
    """Temperature of the device, once a second."""

    def __init__(self, strap: Strap, send: Pipe) -> None:
        self._strap = strap
        self._send = send

    async def run(self) -> None:
        """Measure and send for ever."""
        oscillator = self._strap.oscillator
        device_s = oscillator.now()
        while True:
            device_s += _TEMPERATURE_PERIOD_S
            measured_s = await oscillator.reach(device_s)
            t = np.array([measured_s - self._strap.origin_s])
            celsius = self._strap.wearer.skin_temperature_c(t)[0]
            kelvin = np.float32(celsius - _ABSOLUTE_ZERO_C)
            if await self._send(wire.temperature(round(1000 * device_s), float(kelvin))):
                held = float(kelvin) + _ABSOLUTE_ZERO_C
                self._strap.truth.sent("temp", [measured_s], [(held,)])

    def end(self) -> None:
        """Nothing is missing: it is irregular."""


def stream(strap: Strap, resource: Resource, send: Pipe, deviation: float) -> MeasurementStream:
    """Return what measures a resource."""
    match resource.kind:
        case "hr":
            return HeartRateStream(strap, send)
        case "temp":
            return TemperatureStream(strap, send)
        case "ecg":
            return SampledStream(strap, resource, send, 0.0)
        case _:
            # It has an oscillator of its own.
            return SampledStream(strap, resource, send, deviation)


def _vectors(wearer: Wearer, name: str, t: Floats) -> Floats:
    if name == "acc":
        return wearer.acceleration_g(t)
    axes = [wearer.noise(t, 0.5, f"{name}{axis}") for axis in "xyz"]
    return np.stack(axes, axis=1) + (_FIELD_UT if name == "mag" else 0.0)
