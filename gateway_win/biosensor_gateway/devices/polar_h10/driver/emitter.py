"""Converts the frames of the PMD service to samples of the declared streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    PulseIntervals,
    RegularFrame,
    Rejected,
    measurement_of,
    parse_frame,
)
from biosensor_gateway.devices.restart_check import RestartCheck
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_NS = 1_000_000_000
RATE_TOLERANCE = 0.1
"""Nominal rates are only accurate to 2 %; losses are always whole frames."""
LEARNING_STEPS = 3
"""Number of consecutive frames that must agree on a rate other than the reported one."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A frame's times on the device's clock."""

    times_ns: list[int]  # Device clock of each sample, ascending.
    lost: int  # Number of samples missing before the frame.
    steps_back: bool  # Whether the device's clock did not advance since the previous frame.


class FrameTimeline:
    """Assigns times to the frames of one measurement and layout, over all connections.

    A frame has the timestamp of its last sample. Its samples are evenly spaced since the last
    sample of the previous frame. In the first frame, or after a gap, the previous sample period is
    used, which is initially nominal.

    Parameters
    ----------
    nominal_hz
        Requested sample rate.
    is_doubted
        Set if some firmware reports a wrong rate: then apparent losses in the first frames are not
        counted until these agree on the rate.
    """

    def __init__(self, nominal_hz: float, *, is_doubted: bool = False) -> None:
        self._nominal_hz = nominal_hz
        self._is_doubted = is_doubted
        self._another = _AnotherRate()
        self._nominal_ns = _NS / nominal_hz
        self._measured_ns = 0
        self._measured_samples = 0
        self._previous_ns: int | None = None
        self._last: tuple[int, float] | None = None

    @property
    def rate_hz(self) -> float:
        """Sample rate on the device's clock, as measured so far."""
        return _NS / self._period_ns

    def restart(self, nominal_hz: float) -> None:
        """Restart after the measurement was stopped and started."""
        self._previous_ns = None
        if nominal_hz != self._nominal_hz:
            self._nominal_hz, self._nominal_ns = nominal_hz, _NS / nominal_hz
            self._measured_ns = self._measured_samples = 0

    def place(self, timestamp_ns: int, count: int, arrival_s: float) -> Placed:
        """Assign times to the next frame.

        Parameters
        ----------
        count
            Number of its samples, at least one.
        arrival_s
            Arrival time, to distinguish a gap from a clock that was set.
        """
        previous_ns, self._previous_ns = self._previous_ns, timestamp_ns
        steps_back = previous_ns is not None and timestamp_ns <= previous_ns
        span_ns = 0 if previous_ns is None else timestamp_ns - previous_ns
        period_ns = self._period_ns
        difference = span_ns / period_ns - count
        follows = abs(difference) <= 0.5 + RATE_TOLERANCE * count
        if previous_ns is not None and follows:
            self._measured_ns += span_ns
            self._measured_samples += count
            times = [previous_ns + span_ns * (index + 1) // count for index in range(count)]
            lost = self._another.refute() if self._is_doubted else 0
        else:
            times = [timestamp_ns - round(age * period_ns) for age in reversed(range(count))]
            lost = self._missing(timestamp_ns, count, arrival_s)
            if self._may_learn and previous_ns is not None and not steps_back:
                self._learn(span_ns, count, lost)
                lost = 0
        self._last = (timestamp_ns, arrival_s)
        return Placed(times, lost, steps_back)

    @property
    def _period_ns(self) -> float:
        if not self._measured_samples:
            return self._nominal_ns
        return self._measured_ns / self._measured_samples

    @property
    def _may_learn(self) -> bool:
        return self._is_doubted and not self._measured_samples

    def _learn(self, span_ns: int, count: int, lost: int) -> None:
        """Process a frame that does not match the nominal rate."""
        if self._another.add(span_ns / count, lost) >= LEARNING_STEPS:
            self._measured_ns, self._measured_samples = span_ns, count
            self._another = _AnotherRate()

    def _missing(self, timestamp_ns: int, count: int, arrival_s: float) -> int:
        if self._last is None:
            return 0
        last_ns, last_arrival_s = self._last
        span_ns = timestamp_ns - last_ns
        if abs(span_ns / _NS - (arrival_s - last_arrival_s)) > LONGEST_DELAY_S:
            return 0
        return max(0, round(span_ns / self._period_ns) - count)


class _AnotherRate:
    """Consecutive frames that agree on a rate other than the nominal one."""

    def __init__(self) -> None:
        self._period_ns = 0.0
        self._steps = 0
        self._lost = 0

    def add(self, period_ns: float, lost: int) -> int:
        """Add a sample period; return the number of frames that agree on it so far."""
        if abs(period_ns - self._period_ns) > RATE_TOLERANCE * abs(self._period_ns):
            self._period_ns, self._steps = period_ns, 0
        self._steps += 1
        self._lost += lost
        return self._steps

    def refute(self) -> int:
        """Return the number of samples lost, because the nominal rate is right after all."""
        lost, self._lost, self._steps, self._period_ns = self._lost, 0, 0, 0.0
        return lost


DATA_NAMES: Mapping[Measurement, str] = {
    Measurement.ECG: "ecg",
    Measurement.ACCELERATION: "acc",
}
"""Data names of the strap's streams by measurement."""
LATE_S = 5.0
"""A frame older than the newest one by more than this has a timestamp of a clock that was set."""
_SEEN_KEPT = 64
_MEASUREMENTS = frozenset(Measurement)


class _SeenFrame(NamedTuple):
    """The properties that identify a frame."""

    series: tuple[int, int]
    timestamp_ns: int
    content: int


class _SeenFrames:
    """Detects repeated frames and frames out of order, as reported in polar-ble-sdk #387."""

    def __init__(self) -> None:
        self._newest_ns: dict[tuple[int, int], int] = {}
        # nothing is dropped: these are remembered, not held back
        self._seen: deque[_SeenFrame] = deque(maxlen=_SEEN_KEPT)
        self._was_late = False

    def reason(self, frame: _SeenFrame) -> str:
        """Return why a frame must be left out, as a clause; empty if it is fine."""
        behind_ns = self._newest_ns.get(frame.series, -1) - frame.timestamp_ns
        if behind_ns >= 0:
            if frame in self._seen:
                return "they came twice"
            # Two late frames in a row mean that the clock was set back.
            if 0 < behind_ns < LATE_S * _NS and not self._was_late:
                self._was_late = True
                return "they came after later ones, and are counted as lost"
            self._seen.clear()
        self._newest_ns[frame.series] = frame.timestamp_ns
        self._was_late = False
        self._seen.append(frame)
        return ""


class PolarEmitter:
    """Converts frames to samples; one instance per device, over all its connections.

    Parameters
    ----------
    data_names
        Data names of the declared streams by measurement; frames of others are ignored.
    strap
        Emitter for what all heart-rate straps have; created by default.
    doubted
        Measurements for which some firmware reports a wrong rate.
    """

    def __init__(
        self,
        sink: DeviceSink,
        data_names: Mapping[Measurement, str] = DATA_NAMES,
        *,
        strap: StrapEmitter | None = None,
        doubted: frozenset[Measurement] = frozenset(),
    ) -> None:
        self.data_names = data_names
        self.strap = strap or StrapEmitter(sink)
        # Log of the device; its once-only messages appear once, not once per connection.
        self.log = DeviceLog(f"biosensor_gateway.{sink.identity.sensor}", sink.identity)
        self.clock_runs = False  # Whether the device's clock has a timestamp of this connection.
        # Called with pulse intervals and their arrival time.
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
        """Nominal rates in Hz of all streams started so far, by data name."""
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
            Nominal rate; None for irregular samples.
        factor
            Physical units per count, for compressed frames.
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
        """Note that the device now measures what it refused; the first data may take long."""
        if measurement in self.data_names:
            self._sink.heard(self.data_names[measurement])

    def is_foreign(self, data: bytes) -> bool:
        """Whether a frame belongs to a measurement not started on this connection.

        It was started by a previous host with unknown settings.
        """
        measurement = measurement_of(data)
        return measurement not in self._running and measurement in _MEASUREMENTS

    def frame(self, data: bytes, arrival_s: float) -> None:
        """Emit the samples of a frame; an invalid frame is counted and dropped."""
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
        if not self.clock_runs and self._restarts.counts_again(stamp_s, arrival_s):
            # nothing is dropped: its clock starts again
            self.log.info("the device was switched off, and its count started again")
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
