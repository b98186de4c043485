"""Turns a belt's messages into samples of the declared streams."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from statistics import fmean, pstdev

from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.devices.vernier_respiration_belt.driver.channels import BeltChannels
from biosensor_gateway.devices.vernier_respiration_belt.driver.numbering import (
    Arrived,
    Numbering,
    Placed,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Measurement,
    MeasurementKind,
    Message,
    Notice,
    Status,
)
from biosensor_gateway.system.device_log import DeviceLog

QUALITY_PERIOD_S = 10.0

LOOSE = -1.0
GOOD = 0.0
TIGHT = 1.0

LOOSE_BELOW_N = 1.0
TIGHT_ABOVE_N = 40.0
JUDGED_S = 3.0
"""About one breath: what one sample is does not matter."""
FLAT_BELOW_N = 0.02
FLAT_FOR_S = 10.0
"""Nobody holds his breath so still: a standard deviation below means that nobody wears it."""


class _Fit:
    """The last seconds of the force.

    Parameters
    ----------
    period_s
        Sampling period.
    """

    def __init__(self, period_s: float) -> None:
        # nothing is dropped: these are copies, of which the quality is told
        self._breath: deque[float] = deque(maxlen=max(1, round(JUDGED_S / period_s)))
        # nothing is dropped: these, too
        self._still: deque[float] = deque(maxlen=max(2, round(FLAT_FOR_S / period_s)))

    def add(self, forces: Iterable[float]) -> None:
        """Take in samples in newtons; NaN is passed over."""
        finite = [force for force in forces if math.isfinite(force)]
        self._breath.extend(finite)
        self._still.extend(finite)

    @property
    def tension(self) -> float:
        """-1 loose or not worn, 0 good, 1 tight; NaN before the first sample."""
        if not self._breath:
            return math.nan
        mean = fmean(self._breath)
        if mean < LOOSE_BELOW_N or self._is_flat():
            return LOOSE
        return TIGHT if mean > TIGHT_ABOVE_N else GOOD

    def _is_flat(self) -> bool:
        return len(self._still) == self._still.maxlen and pstdev(self._still) < FLAT_BELOW_N


class VernierEmitter:
    """Turns messages into samples; one instance a device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.log = DeviceLog("biosensor_gateway.vernier", sink.identity)
        self._numbering = Numbering(lambda: sink.clock_state)
        self._force = self._rate = -1
        self._period_s = 1.0
        self._last_s: float | None = None
        self._fit = _Fit(self._period_s)
        self._rate_valid = 0.0
        self._quality = (math.nan, math.nan)
        self._quality_s = -math.inf

    def started(self, channels: BeltChannels, period_s: float) -> None:
        """Expect the samples of a new start of the belt, every ``period_s`` seconds."""
        self.ended()
        self._force, self._rate = channels.force.number, channels.rate.number
        self._period_s = period_s
        self._numbering.restart(period_s)
        self._fit = _Fit(period_s)

    def ended(self) -> None:
        """Emit what was held back: nothing more comes before the next start."""
        for placed in self._numbering.release():
            self._emit(placed)

    def take(self, message: Message, arrival_s: float) -> None:
        """Emit what a message holds.

        Parameters
        ----------
        arrival_s
            LSL clock when the message's last byte arrived.
        """
        self._numbering.count(message.counter)
        if isinstance(message, Notice) and message.kind is MeasurementKind.DROPPED:
            # nothing is dropped: the next counter says how many
            self.log.warning("the belt dropped samples")
            self._numbering.suspect()
        if isinstance(message, Measurement):
            self._measurement(message, arrival_s)

    def take_status(self, status: Status, arrival_s: float) -> None:
        """Emit the battery's level."""
        self._sink.emit_at("bat", [status.battery_percent], [arrival_s])

    def take_rssi(self, rssi_dbm: int | None, arrival_s: float) -> None:
        """Emit the signal strength of an advertisement; None is passed over."""
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [arrival_s])

    def _measurement(self, message: Measurement, arrival_s: float) -> None:
        count = len(message.samples.get(self._force, ()))
        if count:
            for placed in self._numbering.place(Arrived(message, count, arrival_s)):
                self._emit(placed)
        elif self._last_s is not None:
            # Belts send both channels together; should one not, the force keeps the time.
            self._emit_rate(message, self._last_s)
        else:
            # Before the first force nothing tells when it was.
            self._sink.lost("bpm", len(message.samples.get(self._rate, ())))

    def _emit(self, placed: Placed) -> None:
        if placed.lost:
            self._lost(placed.lost)
        forces = placed.measurement.samples[self._force]
        self._last_s = placed.last_s
        if placed.is_first:
            # By how much a start is late must not pass for drift.
            self._sink.restart_clock()
        self._sink.observe(placed.last_s, placed.arrival_s)
        self._sink.emit("force", forces, self._times(len(forces), placed.last_s))
        self._emit_rate(placed.measurement, placed.last_s)
        self._fit.add(forces)
        self._emit_quality(placed.last_s)

    def _emit_rate(self, message: Measurement, last_s: float) -> None:
        rates = message.samples.get(self._rate, ())
        if rates:
            self._rate_valid = float(math.isfinite(rates[-1]))
            self._sink.emit("bpm", rates, self._times(len(rates), last_s))

    def _emit_quality(self, time_s: float) -> None:
        quality = (self._rate_valid, self._fit.tension)
        if quality != self._quality or time_s - self._quality_s >= QUALITY_PERIOD_S:
            self._quality, self._quality_s = quality, time_s
            self._sink.emit("quality", [quality], [time_s])

    def _lost(self, count: int) -> None:
        # nothing is dropped: `lost` counts them below
        self.log.warning("samples were lost", samples=count, estimated=True)
        for data_name in ("force", "bpm"):
            self._sink.lost(data_name, count)

    def _times(self, count: int, last_s: float) -> list[float]:
        return [last_s - ahead * self._period_s for ahead in range(count - 1, -1, -1)]
