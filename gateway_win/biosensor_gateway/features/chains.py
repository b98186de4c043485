"""Puts stages together: what is computed from which type of stream."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from biosensor_common.quantities import ContentType
from biosensor_gateway.features import quality
from biosensor_gateway.features.activity import Activity
from biosensor_gateway.features.breathing import Breathing
from biosensor_gateway.features.heart import Heart
from biosensor_gateway.features.pulse import Pulses
from biosensor_gateway.features.r_peaks import RPeaks
from biosensor_gateway.features.runs import Array, Event, Runs, Stage
from biosensor_gateway.features.skin import Skin


class _Beating:
    """Beats of a waveform."""

    def __init__(self, find: RPeaks | Pulses) -> None:
        self._find, self._heart = find, Heart()

    def take(self, stamps: Array, values: Array) -> list[Event]:
        found = self._find.take(stamps, values)
        return [event for stamp in found for event in self._heart.beat(stamp)]


class _Intervals:
    """Beats that a device tells as intervals, each stamped with the beat that ends it.

    Where the stamps say that beats are missing in between, nothing is bridged.
    """

    def __init__(self) -> None:
        self._heart = Heart()
        self._last: float | None = None

    def take(self, stamps: Array, values: Array) -> list[Event]:
        events: list[Event] = []
        for stamp, interval_s in zip(stamps.tolist(), values.tolist(), strict=True):
            if interval_s <= 0:
                continue  # nothing is dropped: an interval that is not positive is no beat
            if self._last is not None and stamp - self._last > 1.5 * interval_s:
                self._heart = Heart()
            self._last = stamp
            events += self._heart.beat(stamp, interval_s)
        return events


class _Together:
    """Several stages on one column."""

    def __init__(self, *stages: Stage) -> None:
        self._stages = stages

    def take(self, stamps: Array, values: Array) -> list[Event]:
        column = values[:, 0]
        return [event for stage in self._stages for event in stage.take(stamps, column)]


def _waveform(
    content_type: str, first: Callable[[float], Stage], rate: float
) -> Callable[[], Stage]:
    return lambda: _Together(first(rate), quality.Quality(content_type, rate))


def new_runs(content_type: str, rate: float, *, foreign: bool) -> Runs:
    """Return what takes the samples of a stream, as they come, and gives events of features.

    Parameters
    ----------
    content_type
        One that :mod:`.outputs` declares features of.
    rate
        Nominal, in Hz, 0 if irregular.
    foreign
        See :class:`.Runs`.
    """
    makers: dict[str, Callable[[], Stage]] = {
        ContentType.ECG: _waveform("ECG", lambda hz: _Beating(RPeaks(hz)), rate),
        ContentType.PPG: _waveform("PPG", lambda hz: _Beating(Pulses(hz)), rate),
        ContentType.GSR: _waveform("GSR", Skin, rate),
        ContentType.RESPIRATION: _waveform("Respiration", Breathing, rate),
        ContentType.RR: lambda: _Together(_Intervals()),
        ContentType.ACCELEROMETER: partial(Activity, rate),
    }
    return Runs(makers[content_type], rate, foreign=foreign)
