"""A belt that pauses for half a second every few seconds, as one in the field was seen to do."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np
import pytest
from numpy.typing import ArrayLike

from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import BeltChannels
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import VernierEmitter
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Channel,
    Measurement,
    MeasurementKind,
)
from tests.rigs.emitter_sink import EmitterSink

PERIOD_S = 0.1
BEGIN_S = 5000.0
# Issue 37 of the vendor's examples tells of 0.1 s, then 0.52 and 0.58 s, over and over.
STEADY_S = (0.106, 0.096, 0.098, 0.104, 0.098, 0.097, 0.101)
PAUSES_S = (0.518, 0.578)


class Belt(Enum):
    """What may be behind the pauses."""

    MEASURES_NOTHING = 1
    LOSES_PACKETS = 2
    SENDS_LATER = 3


class LslSink(EmitterSink):
    """Notes LSL times as they were when they were emitted."""

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.stamped: list[float] = []

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Note the times."""
        super().emit(data_name, samples, device_times)
        if data_name == "force":
            self.stamped += [self.mapped(each) for each in device_times]


@pytest.mark.parametrize("belt", Belt)
@pytest.mark.parametrize("steady", [3, 7, 60])
def test_what_a_pause_cost_is_counted_and_stamps_stay(belt: Belt, steady: int) -> None:
    sink = LslSink("vernier_respiration_belt")
    emitter = VernierEmitter(sink)
    emitter.started(BeltChannels(*(Channel(k, "", "", 0, 0, 0) for k in (1, 2))), PERIOD_S)
    now_s, counter, sent = BEGIN_S, 0, 0
    steps = [STEADY_S[at % len(STEADY_S)] for at in range(steady)]
    for step_s in [*STEADY_S * 4, *[*steps, *PAUSES_S] * 12, *STEADY_S * 2]:
        now_s += step_s
        missing = round(step_s / PERIOD_S) - 1
        late = range(missing if belt is Belt.SENDS_LATER else 0, -1, -1)
        # Its value is when it was measured.
        values = tuple(now_s - PERIOD_S * each for each in late)
        counter += 1 + (missing if belt is Belt.LOSES_PACKETS else 0)
        sent += len(values)
        forces = {1: values, 2: tuple(14.0 for _ in values)}
        kind = MeasurementKind.NORMAL_REAL32
        emitter.take(Measurement(counter % 256, kind, forces), now_s)
    emitter.ended()
    measured_s = np.array(sink.values("force"))
    errors_s = np.array(sink.stamped) - measured_s
    assert len(measured_s) == sent
    assert np.abs(errors_s).max() < PERIOD_S
    true_lost = round((now_s - BEGIN_S) / PERIOD_S) - sent
    assert sink.losses.get("force", 0) == pytest.approx(true_lost, abs=1)
