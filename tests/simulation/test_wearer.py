"""What a virtual person has: the same each time, and a heart that turns to another rate."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np
import pytest

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import TURN_S, Floats, Wearer
from biosensor_gateway.simulation.world import World
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.virtual_time import virtual_time

STREAMING_S = 30.0


async def _half_a_minute() -> tuple[list[float], list[float]]:
    """Stream and return the values, and their times since the first."""
    with virtual_time() as clock, World(clock) as world:
        radio = Radio(world)
        wearer = Wearer(seed=3, heart_rate_bpm=100)
        with (
            virtual_bluetooth(radio),
            SimulatedPolarH10(world, radio, wearer=wearer, seed=4, jitter_s=0.02) as strap,
        ):
            async with streaming(strap) as run:
                await until(run.sink.has(1, "ecg"))
                await asyncio.sleep(STREAMING_S)
        times = run.sink.times["ecg"]
        return run.sink.values("ecg"), [each - times[0] for each in times]


async def test_half_a_minute_of_streaming_is_the_same_each_time() -> None:
    values, times = await _half_a_minute()
    again, times_again = await _half_a_minute()
    assert times[-1] > STREAMING_S - 2
    assert again == values
    assert times_again == pytest.approx(times, abs=1e-6)


# The heart of a virtual person turns to another rate, and stays a pure function of time.

STEADY = Wearer(heart_rate_bpm=64.0)
TURNED = Wearer(heart_rate_bpm=64.0, turns=((30.0, 120.0),))
COURSES = [
    (),
    ((30.0, 120.0),),
    ((0.0, 40.0),),
    ((30.0, 120.0), (60.0, 50.0)),
    # The second begins within the first, and they are told in any order.
    ((34.0, 60.0), (30.0, 200.0)),
    ((30.0, 90.0), (30.0, 150.0)),
]
T = np.linspace(0.0, 120.0, 24_001)


@pytest.mark.parametrize("turns", COURSES)
def test_beats_are_the_rate_integrated(turns: tuple[tuple[float, float], ...]) -> None:
    wearer = Wearer(heart_rate_bpm=64.0, turns=turns)
    rates = wearer.heart_rate(T) / 60
    counted = np.concatenate(([0.0], np.cumsum((rates[1:] + rates[:-1]) / 2 * np.diff(T))))
    assert wearer.beat_count(T) == pytest.approx(counted, abs=1e-4)


@pytest.mark.parametrize("turns", COURSES)
def test_a_beat_is_when_it_is_counted(turns: tuple[tuple[float, float], ...]) -> None:
    wearer = Wearer(heart_rate_bpm=64.0, turns=turns)
    t = np.linspace(-5.0, 120.0, 500)
    assert wearer.beat_time(wearer.beat_count(t)) == pytest.approx(t, abs=1e-6)
    beats = wearer.beats_between(0.0, 120.0)
    assert wearer.beat_count(beats) == pytest.approx(np.rint(wearer.beat_count(beats)), abs=1e-6)
    assert wearer.rr_before(beats[1:]) == pytest.approx(np.diff(beats), abs=1e-6)


def test_before_it_turns_a_heart_is_as_any_other() -> None:
    t = T[T < 30.0]
    assert TURNED.ecg_uv(t) == pytest.approx(STEADY.ecg_uv(t))
    assert TURNED.heart_rate(t) == pytest.approx(STEADY.heart_rate(t))


def test_the_mean_rate_is_there_at_the_end_of_the_turn_and_stays() -> None:
    after = T[T >= 30.0 + TURN_S]
    # Whole breaths.
    assert TURNED.heart_rate(after[:16_000]).mean() == pytest.approx(120.0, abs=0.1)
    intervals = np.diff(TURNED.beats_between(60.0, 120.0))
    assert 60 / intervals.mean() == pytest.approx(120.0, abs=1.0)
    on_the_way = TURNED.heart_rate(np.array([30.0 + TURN_S / 2]))[0]
    assert 85.0 < on_the_way < 99.0


def test_of_two_turns_at_once_the_higher_one_holds() -> None:
    wearer = Wearer(heart_rate_bpm=64.0, turns=((30.0, 150.0), (30.0, 90.0)))
    assert wearer.heart_rate(np.array([100.0]))[0] == pytest.approx(150.0, rel=0.05)


def test_what_is_flat_has_one_value_and_is_as_any_other_before_and_after() -> None:
    flat, lasting = Wearer(flat=((30.0, 60.0),)), (T >= 30.0) & (T < 60.0)
    measured: list[Callable[[Wearer], Floats]] = [
        lambda wearer: wearer.ecg_uv(T),
        lambda wearer: wearer.pulse(T),
        lambda wearer: wearer.eeg_uv(T, "TP9"),
        lambda wearer: wearer.skin_conductance_us(T),
        lambda wearer: wearer.chest_force_n(T),
    ]
    for measure in measured:
        values, others = measure(flat), measure(Wearer())
        assert np.unique(values[lasting]).size == 1
        assert np.array_equal(values[~lasting], others[~lasting])
