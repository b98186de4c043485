"""How exact stamps are after the clock of Cortex' computer was set."""

from __future__ import annotations

import random

import pytest

from biosensor_gateway.devices.emotiv_insight.driver.emitter import EmotivEmitter
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Sample
from tests.rigs.emitter_sink import EmitterSink

CORTEX_S, LSL_S = 1.7e9, 5000.0
SET_AT_S, END_S = 20.0, 40.0
EEG_HZ, MOTION_HZ = 128, 64
LATE_S = 0.030
MOTION_LATER_S = 0.012


@pytest.mark.parametrize("set_back_s", [0.15, 0.307, 0.45, 3.0, 20.0])
def test_stamps_go_on_at_once(set_back_s: float) -> None:
    sink, rng = EmitterSink("emotiv_insight"), random.Random(1)
    emitter = EmotivEmitter(sink)
    emitter.connected(EEG_HZ, MOTION_HZ, headset_stayed=True)
    measured: list[float] = []
    sent: list[tuple[float, Sample]] = []
    for number in range(round(END_S * EEG_HZ)):
        true_s = number / EEG_HZ
        time_s = CORTEX_S + true_s - set_back_s * (true_s >= SET_AT_S)
        measured.append(true_s)
        sent.append((true_s, Sample("eeg", time_s, {"COUNTER": number % EEG_HZ, "T7": 4200.0}, {})))
        if number % 2 == 0:
            count = {"COUNTER_MEMS": number // 2 % MOTION_HZ, "ACCX": 1.0}
            sent.append((true_s + MOTION_LATER_S, Sample("mot", time_s, count, {})))
    arrival_s = 0.0
    stamps: list[float] = []
    for ready_s, sample in sorted(sent, key=lambda each: each[0]):
        arrival_s = max(arrival_s, LSL_S + ready_s + rng.uniform(0.0, LATE_S))
        emitter.take(sample, arrival_s)
        if sample.stream == "eeg":
            stamps.append(sink.mapped(sample.time_s))

    errors = [stamp - LSL_S - true for stamp, true in zip(stamps, measured, strict=True)]
    assert max(map(abs, errors)) < LATE_S + MOTION_LATER_S
    assert max(map(abs, errors[-EEG_HZ:])) < 0.003
    assert sink.losses == {}
