"""A device whose clock drifts, and a way that delays its packets: how exact are the stamps?

A packet is ready when its last sample was measured. It is never early, so all that a
way does is to delay it; the smallest delay of every way here is 0.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from statistics import fmean

from biosensor_common.device_clock import DeviceClock

DRIFTS_PPM = (-200, -100, 0, 100, 200)
SETTLED_S, END_S = 10.0, 60.0
SIGNAL_HZ = 128
"""Samples a second, as near as whole samples a packet allow."""
BURST_PACKETS = 10
LSL_START_S, DEVICE_START_S = 86_400.0, 1_700_000_000.0

Way = Callable[[random.Random, Sequence[float]], list[float]]
"""Turns the times at which packets are ready into those at which they arrive, seconds."""


def undelayed(_rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Deliver each packet at once."""
    return list(ready)


def uniform_100_ms(rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Delay each packet by 0 to 100 ms, every delay as likely as another."""
    return [time + rng.uniform(0.0, 0.1) for time in ready]


def exponential_20_ms(rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Delay each packet by 20 ms in the mean: mostly little, sometimes much."""
    return [time + rng.expovariate(1 / 0.02) for time in ready]


def in_bursts(rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Hold packets until ten are ready; the first burst is already under way."""
    first = rng.randrange(BURST_PACKETS)
    last = len(ready) - 1
    ends = (number + (first - number) % BURST_PACKETS for number in range(len(ready)))
    return [ready[min(end, last)] for end in ends]


def outliers_1_s(rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Delay one packet in a hundred by 1 s, the others not at all."""
    return [time + (rng.random() < 0.01) for time in ready]


def uniform_100_ms_in_order(rng: random.Random, ready: Sequence[float]) -> list[float]:
    """Delay each packet by 0 to 100 ms, and none overtakes another, as on a serial link."""
    return list(accumulate(uniform_100_ms(rng, ready), max))


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of the stamps that one device's samples got."""

    stamp_rms_ms: float  # Without the mean, which is the constant part of the delay.
    # mean_error_ms, error_rms_ms, largest_error_ms: with nothing taken away; the mean has a sign,
    # positive is late.
    mean_error_ms: float
    error_rms_ms: float
    largest_error_ms: float
    sample_spacing_rms_ms: float  # Of successive samples of a signal with about 128 a second.
    # The same of the packets' last samples: a signal with one sample a packet.
    packet_spacing_rms_ms: float


def simulate(
    rate_hz: int,
    way: Way,
    drift_ppm: float,
    seed: int,
    *,
    settled_s: float = SETTLED_S,
    end_s: float = END_S,
) -> Accuracy:
    """Stamp the samples of one device from its start to `end_s`, each packet as it comes.

    Parameters
    ----------
    rate_hz : int
        Packets a second.
    way : callable
        What becomes of the packets.
    drift_ppm : float
        By how much the device's clock is fast.
    settled_s : float
        From when on errors count, in seconds from the start.
    """
    rng = random.Random(seed)
    clock = DeviceClock()
    per_packet = max(1, round(SIGNAL_HZ / rate_hz))
    period = 1 / rate_hz / per_packet
    errors: list[float] = []
    stamps: list[float] = []

    def device(elapsed: float) -> float:
        return DEVICE_START_S + elapsed * (1 + drift_ppm * 1e-6)

    ready = [packet / rate_hz for packet in range(1, int(end_s * rate_hz) + 1)]
    for last, arrival in zip(ready, way(rng, ready), strict=True):
        clock.observe(device(last), LSL_START_S + arrival)
        if last < settled_s:
            continue
        for sample in range(1 - per_packet, 1):
            elapsed = last + sample * period
            stamps.append(clock.to_lsl(device(elapsed)) - LSL_START_S)
            errors.append(stamps[-1] - elapsed)
    mean = fmean(errors)
    return Accuracy(
        stamp_rms_ms=1e3 * _rms(error - mean for error in errors),
        mean_error_ms=1e3 * mean,
        error_rms_ms=1e3 * _rms(errors),
        largest_error_ms=1e3 * max(map(abs, errors)),
        sample_spacing_rms_ms=_spacing_rms_ms(stamps, period),
        packet_spacing_rms_ms=_spacing_rms_ms(stamps[per_packet - 1 :: per_packet], 1 / rate_hz),
    )


@dataclass(frozen=True, slots=True)
class Summary:
    """Many runs at one rate over one way.

    Attributes
    ----------
    worst_stamp_rms_ms, worst_sample_spacing_rms_ms, worst_packet_spacing_rms_ms
        Of the run in which it is largest; all other RMS and the mean are over all runs.
    largest_error_ms
        Of any stamp.
    """

    runs: int
    stamp_rms_ms: float
    worst_stamp_rms_ms: float
    mean_error_ms: float
    error_rms_ms: float
    largest_error_ms: float
    worst_sample_spacing_rms_ms: float
    packet_spacing_rms_ms: float
    worst_packet_spacing_rms_ms: float


def summary(runs: Sequence[Accuracy]) -> Summary:
    """Put runs of the same length together."""
    return Summary(
        runs=len(runs),
        stamp_rms_ms=_rms(run.stamp_rms_ms for run in runs),
        worst_stamp_rms_ms=max(run.stamp_rms_ms for run in runs),
        mean_error_ms=fmean(run.mean_error_ms for run in runs),
        error_rms_ms=_rms(run.error_rms_ms for run in runs),
        largest_error_ms=max(run.largest_error_ms for run in runs),
        worst_sample_spacing_rms_ms=max(run.sample_spacing_rms_ms for run in runs),
        packet_spacing_rms_ms=_rms(run.packet_spacing_rms_ms for run in runs),
        worst_packet_spacing_rms_ms=max(run.packet_spacing_rms_ms for run in runs),
    )


def _spacing_rms_ms(stamps: Sequence[float], period: float) -> float:
    return 1e3 * _rms(later - earlier - period for earlier, later in pairwise(stamps))


def _rms(values: Iterable[float]) -> float:
    return math.sqrt(fmean(value * value for value in values))
