"""What other streams of a device say beside features: motion, and that skin is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import CoreFields, foreign_header
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import Source, judge
from biosensor_gateway.features.witnesses import Witnesses
from tests.features import signals
from tests.features.signals import Array

SECONDS, PULSE_HZ, ACC_HZ = 60.0, 64.0, 32.0
LATE_S = 1.7
"""How late acceleration is after the pulse of its time, for it comes in other packets."""


def _source(kind: str, unit: str, rate: float, channels: int) -> Source:
    core = CoreFields("Watch", kind, f"watch-{kind}", "host", channels, rate, ChannelFormat.FLOAT32)
    header = foreign_header(core, ("x",) * channels, (unit,) * channels)
    source = judge("Watch", f"watch-{kind}", header)
    assert source is not None
    # Streams of our own say whose they are.
    return replace(source, identity=DeviceIdentity("watch", ""))


PULSE, ACC = _source("PPG", "counts", PULSE_HZ, 1), _source("Accelerometer", "mg", ACC_HZ, 3)


def _acceleration(hertz: float, height_mg: float) -> Array:
    """Return that of an arm that hangs down and swings, with the noise of a sensor."""
    t = np.arange(round(SECONDS * ACC_HZ)) / ACC_HZ
    values = np.tile([0.0, 0.0, 1000.0], (len(t), 1))
    values += 5 * np.random.default_rng(4).standard_normal(values.shape)
    values[:, 0] += height_mg * np.sin(2 * np.pi * hertz * t)
    return values


def _together(pulse: Array, acceleration: Array | None, late_s: float = LATE_S) -> list[Event]:
    """Return what is told of a pulse while acceleration comes beside it, both a bit at a time."""
    witnesses: Witnesses = {}
    computer = PULSE.new_computer(witnesses)
    beside = ACC.new_computer(witnesses)
    events: list[Event] = []
    for second in np.arange(0, SECONDS + 5, 0.5):
        events += computer.take(*_part(pulse, PULSE_HZ, second))
        if acceleration is not None:
            beside.take(*_part(acceleration, ACC_HZ, second - late_s))
    return events


def _part(values: Array, rate: float, begin_s: float) -> tuple[Array, Array]:
    begin, end = (max(0, round(each * rate)) for each in (begin_s, begin_s + 0.5))
    return 100 + np.arange(len(values))[begin:end] / rate, values[begin:end]


def _column(events: Sequence[Event], feature: str, channel: int) -> Array:
    return signals.values_of(list(events), feature)[:, channel]


@pytest.mark.parametrize(("bpm", "hertz"), [(70, 1.0), (70, 1.9), (70, 2.6), (120, 1.0)])
def test_cadence_is_never_a_heart_rate_of_good_quality(bpm: float, hertz: float) -> None:
    beats = signals.regular(bpm, SECONDS)
    swing = signals.swing_of(SECONDS, PULSE_HZ, hertz, height=2.0)
    walks = signals.pulse_of(beats, PULSE_HZ, SECONDS) + swing
    events = _together(walks, _acceleration(hertz, 150))
    rates = _column(events, "hr_live", 0)
    qualities, moves = (_column(events, "hr_live_quality", channel) for channel in (3, 4))
    learnt = signals.stamps_of(list(events), "hr_live_quality") > 12
    near = np.abs(rates[: len(qualities)] - bpm) <= 5
    assert np.all((qualities < 0.5) | near, where=learnt)
    assert moves[learnt].min() == 1
    # The quality of the signal falls as well, and says why.
    assert _column(events, "sqi", 0).max() < 0.5
    assert _column(events, "sqi", 6).min() == 1
    stamps = signals.stamps_of(list(events), "hr_state")
    assert _column(events, "hr_state", 2)[stamps > 12].max() < 0.5
    assert _column(events, "hr_state", 3)[stamps > 12].min() == 1
    assert np.nanmin(_column(events, "hrv_live", 15)) == 1
    assert np.nanmax(_column(events, "hrv_live", 14)) < 0.5


@pytest.mark.parametrize("height_mg", [0.0, 20.0])
def test_who_sits_does_not_move(height_mg: float) -> None:
    pulse = signals.pulse_of(signals.regular(70, SECONDS), PULSE_HZ, SECONDS)
    events = _together(pulse, _acceleration(1.0, height_mg))
    assert _column(events, "sqi", 0).min() > 0.9
    assert set(_column(events, "sqi", 6)) == {0.0}
    assert set(_column(events, "hr_live_quality", 4)) == {0.0}


def test_without_acceleration_motion_is_unknown_and_nothing_waits() -> None:
    pulse = signals.pulse_of(signals.regular(70, SECONDS), PULSE_HZ, SECONDS)
    for events in (_together(pulse, None), _together(pulse, _acceleration(1.0, 150), late_s=30)):
        assert len(signals.stamps_of(events, "sqi")) == pytest.approx(SECONDS - 9, abs=4)
        assert np.isnan(_column(events, "sqi", 6)[:15]).all()
        assert _column(events, "sqi", 0)[:15].min() > 0.9


def test_the_same_comes_when_all_acceleration_is_there_before() -> None:
    pulse = signals.pulse_of(signals.regular(70, SECONDS), PULSE_HZ, SECONDS)
    acceleration = _acceleration(1.0, 150)
    acceleration[: round(20 * ACC_HZ)] = [0, 0, 1000]
    motion = ACC.new_witness()
    assert motion is not None
    motion.take(100 + np.arange(len(acceleration)) / ACC_HZ, ACC.scaled(acceleration))
    computer = PULSE.new_computer({ACC.key: motion})
    whole = computer.take(100 + np.arange(len(pulse)) / PULSE_HZ, pulse) + computer.finish()
    live = _together(pulse, acceleration)
    for feature in ("beats", "hr_live", "hr_live_quality", "hr_state", "sqi", "hrv_live"):
        told, before = ([e for e in each if e.feature == feature] for each in (live, whole))
        assert len(before) - len(told) <= 3, feature
        assert str(told) == str(before[: len(told)]), feature
    assert set(_column(live, "sqi", 6)) == {0.0, 1.0}


SKIN_HZ, CELSIUS_HZ = 4.0, 4.0


def _own(kind: str, label: str, unit: str, rate: float) -> Source | None:
    core = CoreFields("Watch", kind, f"watch-{kind}", "host", 1, rate, ChannelFormat.FLOAT32)
    header = replace(foreign_header(core, (label,), (unit,)), foreign=False)
    source = judge("Watch", f"watch-{kind}", header)
    return source and replace(source, identity=DeviceIdentity("watch", ""))


def _skin(celsius: Array | None, late_s: float = 1.0) -> tuple[Array, Array]:
    """Return the seconds at which quality is told, and what, of skin that is warm or not."""
    skin = _own("GSR", "x", "microsiemens", SKIN_HZ)
    thermometer = _own("Temperature", "skin", "celsius", CELSIUS_HZ)
    assert skin is not None
    assert thermometer is not None
    witnesses: Witnesses = {}
    computer = skin.new_computer(witnesses)
    # One that is there may have something to say, and is waited for.
    beside = thermometer.new_computer(witnesses if celsius is not None else {})
    signal = signals.skin(SKIN_HZ, SECONDS)[0]
    events: list[Event] = []
    for second in np.arange(0, SECONDS + 5, 0.5):
        events += computer.take(*_part(signal, SKIN_HZ, second))
        if celsius is not None:
            assert not beside.take(*_part(celsius, CELSIUS_HZ, second - late_s))
    return signals.stamps_of(events, "sqi"), signals.values_of(events, "sqi")


@pytest.mark.parametrize("cold", [24.0, 29.9, 41.0])
def test_what_is_as_cold_as_a_table_is_no_skin_and_nothing_near_it_is_valid(cold: float) -> None:
    celsius = np.full(round(SECONDS * CELSIUS_HZ), 33.0)
    celsius[round(20 * CELSIUS_HZ) : round(30 * CELSIUS_HZ)] = cold
    stamps, told = _skin(celsius)
    off, near = (stamps > 23) & (stamps < 34.5), (stamps > 20) & (stamps < 40)
    assert told[off, 0].max() < 0.5
    assert told[off, 5].min() == 1
    assert told[~near, 0].min() == 1
    assert told[~near, 5].max() == 0


@pytest.mark.parametrize("celsius", [None, np.full(round(SECONDS * CELSIUS_HZ), 30.5)])
def test_skin_that_is_warm_or_of_which_nothing_is_known_is_good(celsius: Array | None) -> None:
    stamps, told = _skin(celsius)
    assert len(stamps) == pytest.approx(SECONDS - 9, abs=2)
    assert told[:, 0].min() == 1


def test_a_temperature_that_is_late_or_has_no_number_changes_nothing() -> None:
    cold = np.full(round(SECONDS * CELSIUS_HZ), 20.0)
    assert _skin(cold, late_s=30)[1][:5, 0].min() == 1
    assert _skin(cold * np.nan)[1][:, 0].min() == 1


def test_only_what_a_device_of_ours_calls_its_skin_is_asked() -> None:
    assert _own("Temperature", "skin", "celsius", 4) is not None
    for label, unit in (("case", "celsius"), ("skin", "kelvin"), ("", "")):
        assert _own("Temperature", label, unit, 4) is None
    core = CoreFields("T", "Temperature", "t", "host", 1, 4, ChannelFormat.FLOAT32)
    assert judge("T", "t", foreign_header(core, ("skin",), ("celsius",))) is None
