"""Turns the frames of the PMD service into samples of the declared streams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from biosensor_gateway.devices.ble_heart_rate.driver.beats import walk_back
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_heart_rate.driver.stored_beats import (
    Beat,
    PlacedBeat,
    StoredBeats,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    Acceleration,
    Ecg,
    Header,
    Ppg,
    PulseIntervals,
    Rejected,
    measurement_of,
    parse_frame,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.timeline import FrameTimeline
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog

DATA_NAMES = {Measurement.ECG: "ecg", Measurement.ACCELERATION: "acc"}
"""Regular streams of the declaration by measurement."""
RECKONINGS_AGREE_S = 1.0
"""How exactly a device that stayed on agrees with the host on the length of a pause."""
_NS = 1e9
_MEASUREMENTS = frozenset(Measurement)


class PolarEmitter:
    """Turns frames into samples; one instance a device, over all its connections.

    Attributes
    ----------
    strap
        What the device has in common with every heart-rate strap.
    log
        Also for what is to be said once, and not at every connection.
    """

    def __init__(self, sink: Sink) -> None:
        self.strap = StrapEmitter(sink)
        self.log = DeviceLog("biosensor_gateway.polar_h10", sink.identity)
        self._sink = sink
        self._running: set[int] = set()
        self._rates: dict[Measurement, float] = {}
        self._factors: dict[int, float] = {}
        self._timelines: dict[tuple[int, int], FrameTimeline] = {}
        self._beats = StoredBeats()
        self._clock_runs = False
        self._last: tuple[float, float] | None = None

    @property
    def rates(self) -> Mapping[str, float]:
        """Nominal rate in Hz of every stream that was ever started, by data name."""
        return {DATA_NAMES[measurement]: rate for measurement, rate in self._rates.items()}

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self.strap.reconnected()
        self._running.clear()
        self._emit_beats(self._beats.restart())
        self._clock_runs = False

    def started(self, measurement: Measurement, rate_hz: float | None, factor: float) -> None:
        """Prepare for the first frame of a measurement that has just been started.

        Parameters
        ----------
        measurement
        rate_hz
            Nominal rate; None where samples come when they happen.
        factor
            Physical units a count, for compressed frames.
        """
        self._running.add(measurement)
        self._factors[measurement] = factor
        if rate_hz is None:
            return
        self._rates[measurement] = rate_hz
        for (owner, _), timeline in self._timelines.items():
            if owner == measurement:
                timeline.restart(rate_hz)

    def is_foreign(self, data: bytes) -> bool:
        """Whether a frame is of a measurement that we have not started on this connection.

        A host before us did, with settings that nobody knows.
        """
        measurement = measurement_of(data)
        return measurement not in self._running and measurement in _MEASUREMENTS

    def frame(self, data: bytes, arrival_s: float) -> None:
        """Emit what a frame holds; a frame that makes no sense is counted and dropped.

        Parameters
        ----------
        data
        arrival_s
            LSL clock when it arrived.
        """
        frame = parse_frame(data, self._factors)
        match frame:
            case Ecg(header, microvolts):
                self._regular(header, [[value] for value in microvolts], arrival_s)
            case Acceleration(header, counts, g_per_count):
                in_g = [[count * g_per_count for count in sample] for sample in counts]
                self._regular(header, in_g, arrival_s)
            case PulseIntervals():
                self._pulse_intervals(frame, arrival_s)
            case Ppg():
                # The declaration has no stream for it.
                return
            case Rejected():
                self._sink.dropped_bytes += len(data)
                start = data[:10].hex()
                self.log.warn_once("data frames are dropped", cause=frame.value, start=start)
                return
        self._sink.heard()

    def _regular(self, header: Header, samples: list[list[float]], arrival_s: float) -> None:
        measurement = Measurement(header.measurement)
        if not samples or measurement not in self._rates:
            return
        stamp_s = header.timestamp_ns / _NS
        if not self._clock_runs and self._counts_anew(stamp_s, arrival_s):
            self.log.info("the device was switched off and counts anew")
            self._timelines.clear()
            self._sink.restart_clock()
        self._clock_runs, self._last = True, (stamp_s, arrival_s)
        key = (header.measurement, header.frame_type)
        timeline = self._timelines.get(key)
        if timeline is None:
            timeline = self._timelines[key] = FrameTimeline(self._rates[measurement])
        placed = timeline.place(header.timestamp_ns, len(samples), arrival_s)
        name = DATA_NAMES[measurement]
        if placed.steps_back:
            self.log.warn_once("the device's clock did not advance between two frames", data=name)
        if placed.lost:
            self._sink.lost(name, placed.lost)
            self.log.warning("samples were lost", data=name, count=placed.lost, estimated=True)
        self._sink.observe(stamp_s, arrival_s)
        self._sink.emit(name, samples, [time_ns / _NS for time_ns in placed.times_ns])

    def _counts_anew(self, stamp_s: float, arrival_s: float) -> bool:
        """Whether the device's clock did not go on since the last connection."""
        if self._last is None:
            return False
        last_stamp_s, last_arrival_s = self._last
        pause_s = arrival_s - last_arrival_s
        return abs(stamp_s - last_stamp_s - pause_s) > RECKONINGS_AGREE_S + pause_s / 1000

    def _pulse_intervals(self, frame: PulseIntervals, arrival_s: float) -> None:
        self.strap.has_better_intervals = True
        beats = [
            Beat(each.interval_ms / 1000, each.is_valid and each.interval_ms > 0)
            for each in frame.intervals
        ]
        stamp_ns = frame.header.timestamp_ns
        if not (stamp_ns > 0 and self._clock_runs):
            self._emit_beats(self._beats.place(beats, arrival_s))
            return
        # These frames are seconds late, and so never told to the device's clock.
        times = walk_back(stamp_ns / _NS, [beat.interval_s for beat in beats])
        for beat, time_s in zip(beats, times, strict=True):
            if beat.is_valid:
                self._sink.emit("ibi", [beat.interval_s], [time_s])

    def _emit_beats(self, placed: Sequence[PlacedBeat]) -> None:
        for beat, time_s in placed:
            if beat.is_valid:
                self._sink.emit_at("ibi", [beat.interval_s], [time_s])
