"""Converts the lines of the E4 server to samples of the declared streams."""

from __future__ import annotations

import math
from collections.abc import Iterable
from math import inf
from typing import TYPE_CHECKING

from biosensor_gateway.devices.empatica_e4.driver.protocol import Sample, Stream
from biosensor_gateway.system.device_log import DeviceLog
from biosensor_gateway.transports.link import Early

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

ACC_COUNTS_PER_G = 64.0
RATES_HZ = {Stream.BVP: 64.0, Stream.ACC: 32.0, Stream.GSR: 4.0, Stream.TMP: 4.0}

DATA_NAMES = {
    Stream.ACC: "acc",
    Stream.BVP: "bvp",
    Stream.GSR: "gsr",
    Stream.IBI: "ibi",
    Stream.HR: "hr",
    Stream.TMP: "st",
    Stream.BAT: "bat",
}
# Other streams are late by design: conductance comes in bursts, intervals after 5.6 s.
_CLOCKED = (Stream.BVP, Stream.ACC)
_OFF_WRIST_SAMPLES = 8
_MAX_EARLY = 4096
_TAG = "button"

# The server derives timestamps from its sample count, so a loss between wristband and dongle
# leaves no gap: later timestamps merely lag. But since the wristband's rate is known, the expected
# number of samples since the first one is known. Delays increase this deficit temporarily but
# never decrease it, so its minimum over a window is the number of samples lost.
WINDOW_S = 10.0
NOTICEABLE_S = 0.05
"""A smaller deficit may be due to delays, and is left to later windows."""
DRIFT_LIMIT_S = 0.005
"""Deficit of a window that clock drift may explain: 200 ppm cause 2 ms."""
BRIDGED_S = 60.0
"""After a longer silence it is unknown whether the wristband measured at all."""


class LossEstimate:
    """Estimates losses of one regular stream from the arrival of its samples."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1 / rate_hz
        self._arrival_s: float | None = None
        self.forget()

    def forget(self) -> None:
        """Restart, for example after the wristband was switched off."""
        self._first_s: float | None = None
        self._count = 0
        self._accounted_s = 0.0
        self._least_s = inf
        self._window_end_s = inf

    def begin_window(self) -> None:
        """Start a window with the next samples, so that a known gap is reported at its end."""
        self._accounted_s = min(self._accounted_s, self._least_s)
        self._least_s = inf
        self._window_end_s = inf

    def take(self, count: int, arrival_s: float) -> float | None:
        """Add samples; at the end of a window, return the seconds lost in it.

        Parameters
        ----------
        count
            Number of samples that arrived together.
        """
        if self._arrival_s is not None and arrival_s - self._arrival_s > BRIDGED_S:
            self.forget()
        self._arrival_s = arrival_s
        if self._first_s is None:
            self._first_s = arrival_s
        if self._window_end_s == inf:
            self._window_end_s = arrival_s + WINDOW_S
        self._count += count
        deficit_s = arrival_s - self._first_s - self._count * self._period_s
        self._least_s = min(self._least_s, deficit_s)
        if arrival_s < self._window_end_s:
            return None  # nothing is dropped: it estimates losses, and has no samples
        return self._close_window(arrival_s)

    def _close_window(self, arrival_s: float) -> float:
        lost_s = self._least_s - self._accounted_s
        self._least_s = inf
        self._window_end_s = arrival_s + WINDOW_S
        if lost_s >= NOTICEABLE_S:
            self._accounted_s += lost_s
            return lost_s
        # A negative loss means that the first sample was late, so the baseline was too high.
        self._accounted_s += min(lost_s, DRIFT_LIMIT_S)
        return 0.0


class E4Emitter:
    """Converts samples to streams; one instance per wristband, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        # Log of the device; its once-only messages appear once, not once per connection.
        self.log = DeviceLog("biosensor_gateway.empatica_e4", sink.identity)
        self._anchored = False
        self._early = Early[Sample](_MAX_EARLY, is_newest_kept=True)
        self._last_times: dict[Stream, float] = {}
        self._open_samples = 0
        self._worn: bool | None = None
        self._loss = math.nan
        self._gap_is_known = False
        self._estimate = LossEstimate(RATES_HZ[Stream.BVP])
        self._owed = dict.fromkeys(RATES_HZ, 0.0)

    def new_epoch(self) -> None:
        """Expect timestamps that count from a new radio link."""
        self._restart_clock()
        self._gap_is_known = True
        self._estimate.begin_window()

    def switched_off(self) -> None:
        """Note that nothing was measured since the last sample."""
        self._estimate.forget()

    def take(self, samples: Iterable[Sample], arrival_s: float) -> None:
        """Emit samples that arrived together.

        Parameters
        ----------
        arrival_s
            LSL time of arrival.
        """
        came = list(samples)
        # nothing is dropped: copies are counted below
        fresh = [sample for sample in came if self._is_new(sample)]
        if len(fresh) < len(came):
            self._sink.left_out(len(came) - len(fresh), "they came twice")
        clocked = [sample.time_s for sample in fresh if sample.stream in _CLOCKED]
        if clocked:
            self._sink.observe(max(clocked), arrival_s)
            self._anchored = True
        self._early.keep(*fresh)
        if not self._anchored:
            return  # nothing is dropped: `_early` keeps it until the clock is known
        by_stream: dict[Stream, list[Sample]] = {}
        for sample in self._early.take():
            by_stream.setdefault(sample.stream, []).append(sample)
        for stream, together in by_stream.items():
            self._emit(stream, together)
        self._follow_loss(len(by_stream.get(Stream.BVP, ())), arrival_s)

    def _restart_clock(self) -> None:
        self._anchored = False
        self._sink.restart_clock()

    def _is_new(self, sample: Sample) -> bool:
        """Whether a sample is not a repetition of the last one."""
        if self._last_times.get(sample.stream) == sample.time_s:
            return False
        self._last_times[sample.stream] = sample.time_s
        return True

    def _emit(self, stream: Stream, samples: list[Sample]) -> None:
        times = [sample.time_s for sample in samples]
        if stream is Stream.TAG:
            for time in times:
                self._sink.emit_text("tag", _TAG, time)
            return  # nothing is dropped: tags were sent
        values = [sample.values for sample in samples]
        if stream is Stream.ACC:
            values = [tuple(count / ACC_COUNTS_PER_G for count in xyz) for xyz in values]
        elif stream is Stream.BAT:
            values = [(100 * fraction,) for (fraction,) in values]
        elif stream is Stream.GSR:
            # Open electrodes give exactly 0.
            values = [(conductance or math.nan,) for (conductance,) in values]
        self._sink.emit(DATA_NAMES[stream], values, times)
        if stream is Stream.GSR:
            self._follow_wear(values, times)

    def _follow_wear(self, values: list[tuple[float, ...]], times: list[float]) -> None:
        for (conductance,), time in zip(values, times, strict=True):
            self._open_samples = self._open_samples + 1 if math.isnan(conductance) else 0
            worn = self._open_samples < _OFF_WRIST_SAMPLES
            # At the start, a few open samples are not conclusive.
            if worn != self._worn and not (worn and self._open_samples):
                self._worn = worn
                self._emit_quality(time)

    def _follow_loss(self, count: int, arrival_s: float) -> None:
        lost_s = self._estimate.take(count, arrival_s) if count else None
        if lost_s is None:
            return  # nothing is dropped: nothing is known of losses yet
        self._loss = min(1.0, lost_s / WINDOW_S)
        self._emit_quality(self._last_times[Stream.BVP])
        if lost_s:
            self._count_lost(lost_s)
            if not self._gap_is_known:
                # The timestamps lag by the loss.
                self._restart_clock()
        self._gap_is_known = False

    def _count_lost(self, lost_s: float) -> None:
        for stream, rate_hz in RATES_HZ.items():
            self._owed[stream] += lost_s * rate_hz
            whole = math.floor(self._owed[stream] + 0.5)
            self._owed[stream] -= whole
            self._sink.lost(DATA_NAMES[stream], whole)
        seconds = round(lost_s, 2)
        # nothing is dropped: `lost` has counted them
        self.log.warning("samples lost on the radio, estimated from their number", seconds=seconds)

    def _emit_quality(self, time_s: float) -> None:
        worn = math.nan if self._worn is None else float(self._worn)
        self._sink.emit("quality", [[worn, self._loss]], [time_s])
