"""How exact stamps are after a belt was started again, again and again."""

from __future__ import annotations

import random
from statistics import fmean
from typing import NamedTuple

import pytest

from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import BeltChannels
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import VernierEmitter
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Channel,
    Measurement,
    MeasurementKind,
)
from tests.rigs.emitter_sink import EmitterSink

PERIOD_S, DRIFT = 0.1, 30e-6
JITTER_S = 0.06
FORCE, RATE = 1, 2
STARTS, CONNECTED_S, AWAY_S = 6, 60.0, 8.0
SETTLED_S = 10.0


class Stamp(NamedTuple):
    lsl_s: float
    since_start_s: float
    error_s: float
    drift_ppm: float


class Wearing:
    """A belt that is started again and again; the force is the true time of measuring."""

    def __init__(self, seed: int) -> None:
        self._sink = EmitterSink("vernier_respiration_belt")
        self._emitter = VernierEmitter(self._sink)
        self._random = random.Random(seed)
        self._now_s = 5000.0

    def start(self) -> list[Stamp]:
        """Measure for a while, and go away; return what was stamped."""
        channels = (Channel(number, "", "", 0, 0, 0) for number in (FORCE, RATE))
        self._emitter.started(BeltChannels(*channels), PERIOD_S)
        start_s = self._now_s + self._random.uniform(0.0, 1.0)
        stamps: list[Stamp] = []
        arrival_s = 0.0
        for index in range(round(CONNECTED_S / PERIOD_S)):
            true_s = start_s + index * PERIOD_S * (1 + DRIFT)
            arrival_s = max(arrival_s, true_s + self._random.uniform(0.0, JITTER_S))
            content = {FORCE: (true_s,), RATE: (14.0,)}
            kind = MeasurementKind.NORMAL_REAL32
            self._emitter.take(Measurement(index % 256, kind, content), arrival_s)
            device_s = self._sink.device_times["force"][-1]
            lsl_s, drift_ppm = self._sink.mapped(device_s), self._sink.clock_state.drift_ppm
            stamps.append(Stamp(lsl_s, true_s - start_s, lsl_s - true_s, drift_ppm))
        self._now_s = arrival_s + AWAY_S
        return stamps


@pytest.mark.parametrize("seed", range(4))
def test_by_how_much_a_start_is_late_does_not_pass_for_drift(seed: int) -> None:
    belt = Wearing(seed)
    for _ in range(STARTS):
        stamps = belt.start()
        settled = [stamp for stamp in stamps if stamp.since_start_s > SETTLED_S]
        assert max(abs(stamp.error_s) for stamp in settled) < 0.005
        assert abs(fmean(stamp.error_s for stamp in settled)) < 0.001
        assert settled[-1].drift_ppm == pytest.approx(DRIFT * 1e6, abs=50)


def test_stamps_run_on_over_starts() -> None:
    belt = Wearing(1)
    stamps = [stamp for _ in range(STARTS) for stamp in belt.start()]
    measured = [stamp.lsl_s for stamp in stamps]
    assert measured == sorted(measured)
