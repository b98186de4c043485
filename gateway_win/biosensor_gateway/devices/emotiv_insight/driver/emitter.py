"""Converts Cortex samples to samples of the declared streams."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import structlog

from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.emotiv_insight import SPEC
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Sample
from biosensor_gateway.system.device_log import names_in_log

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")

EEG_RATE_HZ = 128.0
MOTION_RATE_HZ = 64.0
"""Rate of the first Insight, used if the headset does not report one."""
BAND_POWER_RATE_HZ = 8.0

CLOCK_STREAMS = frozenset({"eeg", "mot"})
"""Streams sent at once; computed streams have a varying delay."""
_COUNTERS = {"eeg": "COUNTER", "mot": "COUNTER_MEMS"}
# A sample cannot arrive this long before it was measured.
_SET_AHEAD_S = 1.0
_LOST_WITH = {"eeg": ("eeg", "eeg_status"), "mot": ("mot", "gyro"), "pow": ("pow",)}
GYROSCOPE = ("GYROX", "GYROY", "GYROZ")
_METRICS = {
    "engagement": "eng",
    "excitement": "exc",
    "long_term_excitement": "lex",
    "stress": "str",
    "relaxation": "rel",
    "interest": "int",
    "focus": "foc",
    "attention": "attention",
}
_OF_SOME_MODELS = frozenset({"dev", "met", "mot"})
"""Streams whose columns depend on the model and on the version of Cortex."""
# Cortex sends -1 for unknown values.
_NEVER_NEGATIVE = frozenset({"Battery", "BatteryPercent"})

# A sample with a delay this much smaller than any before has a different clock.
_SET_FORWARD_S = 0.25
# How fast the smallest delay is forgotten [s/s], far faster than any oscillator drift.
_DELAY_LEAK = 1e-3
_MAX_BRIDGED_S = 86_400.0
# Tolerance in sample periods within which times are equal.
_SAME_MOMENT = 0.5


class SampleCount:
    """Counts lost samples of one stream by its counter and time.

    The counter restarts each second, so it does not show a loss of whole seconds, but the time
    does; the larger result counts. If the clock was set between two samples, their arrival times
    are used instead.

    Parameters
    ----------
    rate_hz
        Sample rate, which is also the modulus of the counter.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._counter: int | None = None
        self._time_s: float | None = None
        self._arrival_s = 0.0
        self._least_delay_s = math.inf

    def reconnected(self) -> None:
        """Forget the counter, which may not continue in a new connection."""
        self._counter = None

    def forget(self) -> None:
        """Restart, for example after the headset was off."""
        self._counter = self._time_s = None
        self._least_delay_s = math.inf

    def lost_before(self, counter: float, time_s: float, arrival_s: float) -> int | None:
        """Process a sample.

        Parameters
        ----------
        counter
            NaN if the stream has none.
        time_s
            Time of the sample on the device's clock.
        arrival_s
            LSL time of arrival.

        Returns
        -------
        int or None
            Number of samples missing before it; None for a repeated one.
        """
        number = self._usable(counter)
        if self._is_known(number, time_s):
            return None  # nothing is dropped: the caller counts the copy
        lost = 0 if self._time_s is None else self._lost(number, time_s, arrival_s)
        elapsed_s = max(0.0, arrival_s - self._arrival_s)
        self._least_delay_s = min(self._least_delay_s + _DELAY_LEAK * elapsed_s, arrival_s - time_s)
        self._counter, self._time_s, self._arrival_s = number, time_s, arrival_s
        return lost

    @property
    def _modulus(self) -> int:
        return round(self.rate_hz)

    def _usable(self, counter: float) -> int | None:
        # With a fractional rate, or a counter beyond it, the modulus is unknown.
        if 0 <= counter < self._modulus == self.rate_hz and counter == int(counter):
            return int(counter)
        return None  # nothing is dropped: it has no number to place it by

    def _is_known(self, number: int | None, time_s: float) -> bool:
        if self._time_s is None or time_s > self._time_s:
            return False
        behind = (self._time_s - time_s) * self.rate_hz
        if number is None or self._counter is None:
            return behind < _SAME_MOMENT
        # For older samples the number is not enough, because the clock may have been set by a
        # second.
        return (
            behind < self._modulus / 2 and round(behind) == (self._counter - number) % self._modulus
        )

    def _lost(self, number: int | None, time_s: float, arrival_s: float) -> int:
        by_counter = self._lost_by_counter(number)
        pause_s = arrival_s - self._arrival_s
        if not self._is_clock_set(arrival_s - time_s):
            return max(by_counter, self._periods(time_s - (self._time_s or time_s)) - 1)
        # Arrivals jitter, so they only show whole seconds.
        hidden = self._periods(pause_s) - 1 - by_counter
        return by_counter + max(0, round(hidden / self._modulus)) * self._modulus

    def _lost_by_counter(self, number: int | None) -> int:
        if number is None or self._counter is None:
            return 0
        return (number - self._counter - 1) % self._modulus

    def _is_clock_set(self, delay_s: float) -> bool:
        later_s = delay_s - self._least_delay_s
        return later_s < -_SET_FORWARD_S or later_s > LONGEST_DELAY_S

    def _periods(self, seconds: float) -> int:
        return round(seconds * self.rate_hz) if seconds <= _MAX_BRIDGED_S else 0


class EmotivEmitter:
    """Converts Cortex samples to samples of streams; one per device, over all connections.

    All values are identified by label: missing ones are NaN, undeclared ones are left out. EEG
    keeps its offset of about 4200 uV.
    """

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._counts = {
            "eeg": SampleCount(EEG_RATE_HZ),
            "mot": SampleCount(MOTION_RATE_HZ),
            "pow": SampleCount(BAND_POWER_RATE_HZ),
        }
        self._labels = {
            stream.data_name: tuple(channel.label for channel in stream.channels)
            for stream in SPEC.streams
        }
        self._not_yet_heard: set[str] = set()
        self._clock_leads = False
        self._moves_by_gyroscope = False

    def connected(self, eeg_rate_hz: float, motion_rate_hz: float, *, headset_stayed: bool) -> None:
        """Prepare for a new connection.

        Parameters
        ----------
        eeg_rate_hz, motion_rate_hz
            Current rates of the headset.
        headset_stayed
            Whether it stayed connected to Cortex, and so continued to measure.
        """
        self._counts["eeg"].rate_hz = eeg_rate_hz
        self._counts["mot"].rate_hz = motion_rate_hz
        for count in self._counts.values():
            if headset_stayed:
                count.reconnected()
            else:
                count.forget()
        self._not_yet_heard = set(self._counts)
        self._clock_leads = False

    def offered(self, columns: Mapping[str, Collection[str]]) -> None:
        """Note what headset and Cortex do not have: a focus or attention, orientation, grades."""
        for data_name in columns.keys() & _OF_SOME_MODELS:
            self._sink.lacking[data_name] = [
                label
                for label in self._labels[data_name]
                if _METRICS.get(label, label) not in columns[data_name]
            ]

    def take(self, sample: Sample, arrival_s: float) -> None:
        """Emit a sample."""
        lost = self._lost_before(sample, arrival_s)
        if lost is None:
            self._sink.left_out(1, "they came twice")
            return
        self._observe(sample, arrival_s)
        match sample.stream:
            case "eeg":
                self._emit("eeg", sample, self._labels["eeg"])
                self._emit("eeg_status", sample, self._labels["eeg_status"])
            case "mot":
                self._emit("mot", sample, self._labels["mot"])
                self._moves_by_gyroscope = not sample.numbers.keys().isdisjoint(GYROSCOPE)
                if self._moves_by_gyroscope:
                    self._emit("gyro", sample, GYROSCOPE)
            case "pow":
                self._emit("pow", sample, self._labels["pow"])
            case "met":
                values = [_metric(sample, _METRICS[name]) for name in self._labels["met"]]
                self._emit_known("met", values, sample.time_s)
            case "dev":
                values = [_status(sample, label) for label in self._labels["dev"]]
                self._emit_known("dev", values, sample.time_s)
                if sample.numbers.get("OVERALL") == 0:
                    # The headset is not worn, so there may be no data for band powers.
                    self._sink.excuse("pow")
            case _:
                pass
        if lost:
            self._report_lost(sample.stream, lost)
        self._not_yet_heard.discard(sample.stream)

    def _observe(self, sample: Sample, arrival_s: float) -> None:
        if sample.stream in CLOCK_STREAMS:
            self._clock_leads = True
        elif self._clock_leads and not self._is_clock_set(sample.time_s, arrival_s):
            return  # nothing is dropped: only the clock is not told of it
        self._sink.observe(sample.time_s, arrival_s, sample.stream)

    def _is_clock_set(self, time_s: float, arrival_s: float) -> bool:
        """Whether Cortex's clock was set forward; the first stream that shows it counts."""
        return time_s + self._sink.clock_state.offset_s - arrival_s > _SET_AHEAD_S

    def _lost_before(self, sample: Sample, arrival_s: float) -> int | None:
        count = self._counts.get(sample.stream)
        if count is None:
            return 0  # nothing is dropped: an unnumbered stream cannot tell
        counter = sample.numbers.get(_COUNTERS.get(sample.stream, ""), math.nan)
        return count.lost_before(counter, sample.time_s, arrival_s)

    def _report_lost(self, stream: str, lost: int) -> None:
        for data_name in _LOST_WITH[stream]:
            if data_name != "gyro" or self._moves_by_gyroscope:
                self._sink.lost(data_name, lost)
        if stream in self._not_yet_heard:
            names = {**names_in_log(self._sink.identity), "data": stream, "samples": lost}
            # nothing is dropped: `lost` has counted them
            _log.warning("samples were lost between two connections, by estimate", **names)

    def _emit(self, data_name: str, sample: Sample, labels: Sequence[str]) -> None:
        """Emit a sample of a regular stream, with NaN for missing values."""
        values = [sample.numbers.get(label, math.nan) for label in labels]
        self._sink.emit(data_name, [values], [sample.time_s])

    def _emit_known(self, data_name: str, values: list[float], time_s: float) -> None:
        """Emit a sample of an irregular stream, if it has any value."""
        if not all(map(math.isnan, values)):
            self._sink.emit(data_name, [values], [time_s])


def _metric(sample: Sample, label: str) -> float:
    if sample.others.get(f"{label}.isActive") is False:
        return math.nan
    return sample.numbers.get(label, math.nan)


def _status(sample: Sample, label: str) -> float:
    value = sample.numbers.get(label, math.nan)
    return math.nan if label in _NEVER_NEGATIVE and value < 0 else value
