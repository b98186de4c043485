"""That what a converter or a link repeats is not called a good signal, and that no heart is."""

from __future__ import annotations

import numpy as np
import pytest

from biosensor_gateway.features.repeats import repeats
from tests.features import signals
from tests.features.signals import Array

WAVES = [("ECG", 100.0), ("ECG", 250.0), ("ECG", 1000.0), ("PPG", 25.0), ("PPG", 64.0)]


def _window(kind: str, rate: float, bpm: float = 80, seed: int = 1) -> Array:
    beats = signals.regular(bpm, 10, seed=seed)
    make = signals.ecg_of if kind == "ECG" else signals.pulse_of
    return make(beats, rate, 10, seed=seed)


@pytest.mark.parametrize("held_s", [0.3, 0.7, 2.0])
@pytest.mark.parametrize(("kind", "rate"), WAVES)
def test_one_value_that_is_held_makes_a_window_flat(kind: str, rate: float, held_s: float) -> None:
    for counts in (0, 4095):
        signal = _window(kind, rate)
        begin = round(4.21 * rate)
        signal[begin : begin + round(held_s * rate)] = signal[begin]
        if counts:
            signal = np.round(signal * counts / np.ptp(signal))
        assert repeats(signal, rate)["flat"], counts


@pytest.mark.parametrize("block_s", [0.45, 1.5])
@pytest.mark.parametrize("later_s", [0.0, 2.0])
@pytest.mark.parametrize(("kind", "rate"), WAVES)
def test_one_block_that_is_sent_twice_makes_a_window_flat(
    kind: str, rate: float, later_s: float, block_s: float
) -> None:
    for counts in (0, 4095):
        signal, length = _window(kind, rate), round(block_s * rate)
        begin = round(3 * rate)
        to = begin + length + round(later_s * rate)
        signal[to : to + length] = signal[begin : begin + length]
        if counts:
            signal = np.round(signal * counts / np.ptp(signal))
        assert repeats(signal, rate)["flat"], counts


@pytest.mark.parametrize("counts", [0, 30, 255, 1023, 4095, 65535])
@pytest.mark.parametrize(("kind", "rate"), WAVES)
def test_no_steps_of_a_converter_make_a_heart_flat(kind: str, rate: float, counts: int) -> None:
    for seed in range(6):
        signal = _window(kind, rate, 40 + 25 * seed, seed)
        if counts:
            signal = np.round(signal * counts / np.ptp(signal))
        assert not repeats(signal, rate)["flat"], seed
        # Each value twice or four times, as of a slower converter.
        assert not repeats(np.repeat(signal, 4), 4 * rate)["flat"], seed
