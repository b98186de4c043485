"""Turns the frames of the PMD service into samples of the declared streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    PulseIntervals,
    RegularFrame,
    Rejected,
    measurement_of,
    parse_frame,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.timeline import FrameTimeline
from biosensor_gateway.devices.restarts import RestartCheck
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog

DATA_NAMES: Mapping[Measurement, str] = {
    Measurement.ECG: "ecg",
    Measurement.ACCELERATION: "acc",
}
"""Streams of the strap by measurement."""
LATE_S = 5.0
"""A frame whose stamp is older than the newest by more was stamped by a clock that was set."""
_SEEN_KEPT = 64
_NS = 1e9
_MEASUREMENTS = frozenset(Measurement)


class _SeenFrame(NamedTuple):
    """What tells a frame from others."""

    series: tuple[int, int]
    timestamp_ns: int
    content: int


class _SeenFrames:
    """Finds frames that came twice or behind later ones, as reported in polar-ble-sdk #387."""

    def __init__(self) -> None:
        self._newest_ns: dict[tuple[int, int], int] = {}
        # nothing is dropped: these are remembered, not held back
        self._seen: deque[_SeenFrame] = deque(maxlen=_SEEN_KEPT)
        self._was_late = False

    def reason(self, frame: _SeenFrame) -> str:
        """Return why a frame must be left out, as a clause; empty if it must not."""
        behind_ns = self._newest_ns.get(frame.series, -1) - frame.timestamp_ns
        if behind_ns >= 0:
            if frame in self._seen:
                return "they came twice"
            # Two late ones in a row are of a clock that was set back.
            if 0 < behind_ns < LATE_S * _NS and not self._was_late:
                self._was_late = True
                return "they came behind later ones, and are counted as lost"
            self._seen.clear()
        self._newest_ns[frame.series] = frame.timestamp_ns
        self._was_late = False
        self._seen.append(frame)
        return ""


class PolarEmitter:
    """Turns frames into samples; one instance a device, over all its connections.

    Parameters
    ----------
    data_names
        By measurement, the streams of the declaration; frames of others are passed over.
    strap
        Takes what the device has in common with every heart-rate strap; one by default.
    doubted
        Measurements whose rate firmware is known to say wrong.

    Attributes
    ----------
    log
        Also for what is to be said once, and not at every connection.
    clock_runs
        Whether a stamp of this connection was told to the device's clock.
    on_intervals
        Takes intervals between pulse waves, and when they arrived.
    """

    def __init__(
        self,
        sink: Sink,
        data_names: Mapping[Measurement, str] = DATA_NAMES,
        *,
        strap: StrapEmitter | None = None,
        doubted: frozenset[Measurement] = frozenset(),
    ) -> None:
        self.data_names = data_names
        self.strap = strap or StrapEmitter(sink)
        self.log = DeviceLog(f"biosensor_gateway.{sink.identity.sensor}", sink.identity)
        self.clock_runs = False
        self.on_intervals: Callable[[PulseIntervals, float], None] | None = None
        self._sink = sink
        self._doubted = doubted
        self._running: set[int] = set()
        self._rates: dict[Measurement, float] = {}
        self._factors: dict[int, float] = {}
        self._timelines: dict[tuple[int, int], FrameTimeline] = {}
        self._restarts = RestartCheck(sink)
        self._seen = _SeenFrames()

    @property
    def rates(self) -> Mapping[str, float]:
        """Nominal rate in Hz of every stream that was ever started, by data name."""
        return {self.data_names[measurement]: rate for measurement, rate in self._rates.items()}

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self.strap.reconnected()
        self._running.clear()
        self._restarts.reconnected()
        self.clock_runs = False
        self._seen = _SeenFrames()

    def started(self, measurement: Measurement, rate_hz: float | None, factor: float) -> None:
        """Prepare for the first frame of a measurement that has just been started.

        Parameters
        ----------
        rate_hz
            Nominal rate; None where samples come when they happen.
        factor
            Physical units a count, for compressed frames.
        """
        self._running.add(measurement)
        self._factors[measurement] = factor
        if rate_hz is None or measurement not in self.data_names:
            return  # nothing is dropped: a measurement without a stream of its own
        self._rates[measurement] = rate_hz
        for (owner, _), timeline in self._timelines.items():
            if owner == measurement:
                timeline.restart(rate_hz)

    def agreed(self, measurement: Measurement) -> None:
        """Note that the device measures what it refused, and that may be long in coming."""
        if measurement in self.data_names:
            self._sink.heard(self.data_names[measurement])

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
        arrival_s
            LSL clock when it arrived.
        """
        frame = parse_frame(data, self._factors)
        match frame:
            case Rejected():
                self._sink.dropped_bytes += len(data)
                start = data[:10].hex()
                self.log.warn_once("data frames are dropped", cause=frame.value, start=start)
                return
            case PulseIntervals():
                if self.on_intervals is not None:
                    self.on_intervals(frame, arrival_s)
            case _:
                self._regular(frame, arrival_s)
        self._sink.heard()

    def _regular(self, frame: RegularFrame, arrival_s: float) -> None:
        header, samples = frame.header, frame.samples
        measurement = Measurement(header.measurement)
        if not samples or measurement not in self._rates:
            return  # nothing is dropped: nobody started that measurement
        key = (header.measurement, header.frame_type)
        reason = self._seen.reason(_SeenFrame(key, header.timestamp_ns, hash(repr(samples))))
        if reason:
            self._sink.left_out(len(samples), reason)
            return
        stamp_s = header.timestamp_ns / _NS
        if self._restarts.counts_again(stamp_s, arrival_s):
            # nothing is dropped: its clock starts again
            self.log.info("the device was switched off and counts again")
            self._timelines.clear()
            self._sink.restart_clock()
        self.clock_runs = True
        timeline = self._timelines.get(key)
        if timeline is None:
            timeline = self._timelines[key] = FrameTimeline(
                self._rates[measurement], is_doubted=measurement in self._doubted
            )
        placed = timeline.place(header.timestamp_ns, len(samples), arrival_s)
        name = self.data_names[measurement]
        if placed.steps_back:
            self.log.warn_once("the device's clock did not advance between two frames", data=name)
        if placed.lost:
            self._sink.lost(name, placed.lost)
            self.log.warning("samples were lost", data=name, count=placed.lost, estimated=True)
        self._sink.observe(stamp_s, arrival_s)
        self._sink.emit(name, samples, [time_ns / _NS for time_ns in placed.times_ns])
