"""The measurement that a strap sends once a second."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.devices.ble_heart_rate.simulator.heart import BeatDetector, Interval
from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import (
    RR_TICKS_PER_S,
    HeartRateMeasurement,
)
from biosensor_gateway.simulation.truth import Truth


class Pulse:
    """Heart rate and intervals, from detector to truth.

    Parameters
    ----------
    detector
    tells_contact
        Measurements say whether the strap touches the skin.
    sends_rr
        Measurements carry R-R intervals.

    Attributes
    ----------
    repeats
        The last interval of each measurement is told in the next one again.
    """

    def __init__(self, detector: BeatDetector, *, tells_contact: bool, sends_rr: bool) -> None:
        self._detector = detector
        self._tells_contact = tells_contact
        self._sends_rr = sends_rr
        self._intervals: Sequence[Interval] = ()
        self._worn = True
        self._last: tuple[int, ...] = ()
        self.repeats = False

    @property
    def bpm(self) -> int:
        """The rate that is shown [1/min]; 0 = none."""
        return self._detector.bpm

    def measure(self, until_s: float, *, worn: bool) -> HeartRateMeasurement:
        """Return what there is to send at an LSL time."""
        self._worn = worn
        if worn:
            self._intervals = self._detector.search(until_s)
        else:
            self._intervals = ()
            self._detector.lose(until_s)
        told = tuple(interval.rr for interval in self._intervals)
        again, self._last = self._last if self.repeats else (), told[-1:] or self._last
        return HeartRateMeasurement(
            self.bpm,
            again + told if self._sends_rr else None,
            worn if self._tells_contact else None,
        )

    def note(self, truth: Truth, measured_s: float, *, sent: bool) -> None:
        """Enter the last measurement as sent or as lost."""
        rows: dict[str, tuple[list[float], list[tuple[float]]]] = {
            "quality": ([measured_s], [(float(self._worn),)])
        }
        if self.bpm:
            rows["hr"] = ([measured_s], [(float(self.bpm),)])
        if self._sends_rr and self._intervals:
            times = [interval.time for interval in self._intervals]
            rows["ibi"] = (times, [(one.rr / RR_TICKS_PER_S,) for one in self._intervals])
        for data_name, (times, values) in rows.items():
            if sent:
                truth.sent(data_name, times, values)
            else:
                truth.unsent(data_name, len(times))
