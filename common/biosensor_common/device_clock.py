"""Maps the clock of one device to the LSL clock.

A packet that was ready at device time ``d`` arrives at LSL time ``a``, and
``a - d`` is the offset between the two clocks plus the transmission delay. The
delay is never negative and often close to its minimum, so the offset runs along
the *lower edge* of the points ``(d, a - d)``; averages would follow the radio's
jitter. `DeviceClock` keeps a straight line under that edge and moves its output
to the line without ever turning back.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, unique

from biosensor_common.lower_envelope import LateRun, LowerEnvelope, Patience

READING_LIMIT_S = 1e11
"""64 bits of nanoseconds end at 1.8e10 s, so a larger number is not a time."""
BACKWARD_LIMIT_S = 2.5
"""Interleaved kinds of packets may lag up to 2 s behind each other; a larger lag is a clock step
or a delayed packet."""
TURNED_BACK_LIMIT_S = 0.1
"""Packets of one kind keep their order, and counted or smoothed stamps vary by less than this."""
BELOW_LIMIT_S = 1.0
LONGEST_DELAY_S = 90.0
"""Packets that waited while the computer slept for up to a minute are late; the clock did not step.
Few connections survive a longer sleep."""
FAR_ABOVE_LIMIT_S = LONGEST_DELAY_S
SET_BACK = Patience(2.0, 5, spread=0.2)
"""Within this time a stall ends: a packet arrives on time, or the delays shrink."""
STAYED_ABOVE_LIMIT_S = 0.5
STAYED_ABOVE = Patience(5.0, 10)
SLIGHTLY_ABOVE_LIMIT_S = 0.1
"""Less than 128 ms, from which time services step a clock instead of slewing it."""
SLIGHTLY_ABOVE_DELAYS = 4.0
"""In mean delays. By chance, ten half seconds all have such delays once in e**40 cases."""
SLIGHTLY_ABOVE = Patience(5.0, 20, spread=0.5)
SLEW_TIME_CONSTANT_S = 1.0
SLEW_LIMIT = 0.5
"""Reached only after a clock step or a backlog at the start: usual errors need less than 1 %."""
SLEW_SHARE = 0.25
"""Largest part of an error corrected in one segment; keeps the spacing at one packet per second."""
SEGMENT_MIN_S = 0.05
HISTORY_SEGMENTS = 512
"""Late samples can be mapped for at least 12 s."""


@unique
class ReanchorReason(Enum):
    """Why the mapping was re-anchored."""

    DEVICE_BACKWARD = "device_backward"
    """Device time fell far behind the newest seen: a restart, or its clock was set."""
    BELOW = "below"
    """A packet came earlier than any delay explains: the device clock stepped forward."""
    FAR_ABOVE = "far_above"
    """A packet is later than any stall can make it."""
    STAYED_ABOVE = "stayed_above"
    """Packets stay late: the device clock stepped back, or the transmission delay grew."""


@dataclass(frozen=True, slots=True)
class Reanchor:
    """A step of the mapping.

    Attributes
    ----------
    reason : ReanchorReason
    size_s : float
        By how much the LSL time of the observed device time changed, in seconds.
    """

    reason: ReanchorReason
    size_s: float


@dataclass(frozen=True, slots=True)
class ClockState:
    """State of a device clock, for diagnostics.

    Attributes
    ----------
    offset_s : float
        LSL time minus device time at the newest device time; NaN before the first
        observation. Includes the smallest transmission delay.
    drift_ppm : float
        LSL microseconds gained per device second: positive for a slow device clock;
        NaN before the first observation.
    residual_rms_s : float
        RMS distance of the lowest points of each half second from the line; NaN
        before the first observation.
    reanchors : int
    observations : int
    newest_s : float
        LSL time of the newest device time; NaN before the first observation.
    """

    offset_s: float
    drift_ppm: float
    residual_rms_s: float
    reanchors: int
    observations: int
    newest_s: float = math.nan


class DeviceClock:
    """Maps device seconds to LSL seconds; one instance per device.

    The mapping is continuous, piecewise linear and strictly increasing in device
    time between two re-anchors (down to the resolution of a float). Up to the
    newest observed device time it is final; beyond, it is extrapolated and the
    next observation may still bend it. So observe a packet first, then map its
    samples: they lie on one straight piece and keep their spacing.

    Notes
    -----
    One-way delays cannot show two errors: the smallest transmission delay (constant)
    and, in the first seconds, how much later than that the fastest packet so far
    arrived. A step of less than 0.1 s that delays packets, or one of
    less than four mean delays, is followed only as old points leave the window.
    """

    def __init__(self) -> None:
        self._envelope: LowerEnvelope | None = None
        self._mapping = SlewedMapping(0.0)
        self._device_origin = math.nan
        self._lsl_origin = math.nan
        self._newest = 0.0
        self._newest_of_kind: dict[str, float] = {}
        self._late, self._slightly_late = LateRun(), LateRun()
        self._slope = 0.0
        self._reanchors = 0
        self._observations = 0

    def restart(self) -> None:
        """Forget the offset, because the device's clock started again; counted as a re-anchor.

        The oscillator is the same, so the drift stays as a first guess. Nothing can be
        mapped before the next observation.
        """
        if self._envelope is not None:
            self._slope = self._envelope.slope
            self._envelope = None
            self._reanchors += 1

    def observe(
        self, device_s: float, arrival_s: float, kind: str = "", own_delay_s: float = 0.0
    ) -> Reanchor | None:
        """Add the observation of one packet.

        Parameters
        ----------
        device_s : float
            Device time of the packet's last sample, in seconds. Kinds of packets
            may interleave: up to 2 s behind the newest is normal.
        arrival_s : float
            LSL clock when the packet arrived, in seconds.
        kind : str
            Kind of the packet, if packets of one kind keep their order. The first one that is
            behind then shows that the clock was set back.
        own_delay_s : float
            How long the packet may have waited for this computer, in seconds. Such a delay is
            not taken as a step of the device's clock.

        Returns
        -------
        Reanchor or None
            The step, if the mapping was re-anchored.

        Raises
        ------
        ValueError
            If an argument is not finite, or beyond 1e11 s.
        """
        _require_readings(device_s, arrival_s)
        self._observations += 1
        if self._envelope is None:
            self._envelope = self._anchor(device_s, arrival_s, self._slope)
            return None
        x = device_s - self._device_origin
        y = (arrival_s - self._lsl_origin) - x
        distance = y - self._envelope.at(x)
        self._note_late(x, distance, arrival_s, self._envelope, own_delay_s)
        jump = self._jump(x, distance, (x + y) - self._mapping.at(x), kind)
        if jump is not None:
            return self._reanchor(self._envelope, device_s, *jump)
        self._envelope.add(x, y)
        self._newest = max(self._newest, x)
        if kind:
            self._newest_of_kind[kind] = x
        self._mapping.advance(x, self._envelope)
        return None

    def to_lsl(self, device_s: float) -> float:
        """Return the LSL time, in seconds, of a device time in seconds.

        Raises
        ------
        ValueError
            If `device_s` is not finite, or beyond 1e11 s.
        RuntimeError
            Before the first observation, also after `restart`.
        """
        return self.all_to_lsl([device_s])[0]

    def all_to_lsl(self, device_times: Sequence[float]) -> list[float]:
        """Map many device times; an empty list needs no observation before."""
        _require_readings(*device_times)
        if device_times and self._envelope is None:
            raise RuntimeError("a device clock cannot map times before its first observation")
        return self._mapping.all_at(device_times, self._device_origin, self._lsl_origin)

    @property
    def state(self) -> ClockState:
        """The present offset, drift and counts."""
        if self._envelope is None:
            return ClockState(math.nan, math.nan, math.nan, self._reanchors, self._observations)
        newest = self._device_origin + self._newest
        newest_lsl = self.to_lsl(newest)
        return ClockState(
            offset_s=newest_lsl - newest,
            drift_ppm=self._envelope.slope * 1e6,
            residual_rms_s=self._envelope.residual_rms(),
            reanchors=self._reanchors,
            observations=self._observations,
            newest_s=newest_lsl,
        )

    def _note_late(
        self, x: float, distance: float, arrival_s: float, line: LowerEnvelope, own_delay_s: float
    ) -> None:
        is_behind = x < self._newest - BACKWARD_LIMIT_S
        slightly_s = max(SLIGHTLY_ABOVE_LIMIT_S, SLIGHTLY_ABOVE_DELAYS * line.mean_delay)
        limit_s = STAYED_ABOVE_LIMIT_S + own_delay_s
        self._late.add(distance, limit_s, arrival_s, behind=is_behind)
        self._slightly_late.add(distance, slightly_s + own_delay_s, arrival_s)

    def _jump(
        self, x: float, distance: float, delay: float, kind: str
    ) -> tuple[ReanchorReason, float] | None:
        """Return why to re-anchor, and how late packets are by the line; None to keep it."""
        if delay < -BELOW_LIMIT_S:
            return ReanchorReason.BELOW, distance
        if x < self._newest_of_kind.get(kind, -math.inf) - TURNED_BACK_LIMIT_S:
            return ReanchorReason.DEVICE_BACKWARD, distance
        if distance > FAR_ABOVE_LIMIT_S:
            is_behind = x < self._newest - BACKWARD_LIMIT_S
            reason = ReanchorReason.DEVICE_BACKWARD if is_behind else ReanchorReason.FAR_ABOVE
            return reason, distance
        # The fastest packet of a late run shows the new offset best.
        if self._late.began_behind and self._late.outlasts(SET_BACK):
            return ReanchorReason.DEVICE_BACKWARD, self._late.least
        if self._late.outlasts(STAYED_ABOVE) or self._slightly_late.outlasts(SLIGHTLY_ABOVE):
            return ReanchorReason.STAYED_ABOVE, self._slightly_late.least
        return None

    def _reanchor(
        self, envelope: LowerEnvelope, device_s: float, reason: ReanchorReason, late_s: float
    ) -> Reanchor:
        x = device_s - self._device_origin
        target = x + envelope.at(x) + late_s
        size = target - self._mapping.at(x)
        # The oscillator is the same as before the step, so its drift is a good first guess.
        self._envelope = self._anchor(device_s, self._lsl_origin + target, envelope.slope)
        self._reanchors += 1
        return Reanchor(reason, size)

    def _anchor(self, device_s: float, lsl_s: float, slope: float) -> LowerEnvelope:
        """Start over at one point; coordinates are relative to it to keep precision."""
        self._device_origin = device_s
        self._lsl_origin = lsl_s
        self._newest = 0.0
        self._newest_of_kind = {}
        self._late, self._slightly_late = LateRun(), LateRun()
        self._mapping = SlewedMapping(slope)
        return LowerEnvelope(slope)


def _require_readings(*readings: float) -> None:
    for reading in readings:
        if not abs(reading) <= READING_LIMIT_S:
            raise ValueError(f"no clock reads {reading} s")


class SlewedMapping:
    """Continuous, strictly increasing map of device to LSL time, both from the anchor.

    Parameters
    ----------
    slope : float
        Expected drift, seconds per second.
    """

    def __init__(self, slope: float) -> None:
        # The piece before the anchor is separate, so that later bends leave it alone.
        rate = 1.0 + slope
        self._starts = [-SEGMENT_MIN_S, 0.0]
        self._values = [-SEGMENT_MIN_S * rate, 0.0]
        self._rates = [rate, rate]

    def at(self, x: float) -> float:
        """Map a time."""
        return self.all_at([x])[0]

    def all_at(self, times: Sequence[float], x0: float = 0.0, y0: float = 0.0) -> list[float]:
        """Map times relative to `x0` to times relative to `y0`."""
        starts, values, rates = self._starts, self._values, self._rates
        mapped: list[float] = []
        for time in times:
            x = time - x0
            piece = max(bisect_right(starts, x) - 1, 0)
            mapped.append(y0 + (values[piece] + rates[piece] * (x - starts[piece])))
        return mapped

    def advance(self, x: float, target: LowerEnvelope) -> None:
        """Fix the map up to `x`, moving towards the target line."""
        start, value = self._starts[-1], self._values[-1]
        step = x - start
        if step <= 0.0:
            return
        drift_rate = 1.0 + target.slope
        if x - self._starts[-2] < SEGMENT_MIN_S:
            # Packets a few ms apart extend the last piece, which bounds the number of pieces.
            value = self._values[-2] + self._rates[-2] * (x - self._starts[-2])
            self._starts[-1], self._values[-1], self._rates[-1] = x, value, drift_rate
            return
        self._rates[-1] = drift_rate + _slew(start + target.at(start) - value, step)
        self._starts.append(x)
        self._values.append(value + self._rates[-1] * step)
        self._rates.append(drift_rate)
        if len(self._starts) > 2 * HISTORY_SEGMENTS:
            for column in (self._starts, self._values, self._rates):
                del column[:-HISTORY_SEGMENTS]


def _slew(error: float, step: float) -> float:
    """Return the rate, in s/s, that corrects an error over the next `step` seconds."""
    share = min(1.0 - math.exp(-step / SLEW_TIME_CONSTANT_S), SLEW_SHARE)
    return min(max(error * share / step, -SLEW_LIMIT), SLEW_LIMIT)
