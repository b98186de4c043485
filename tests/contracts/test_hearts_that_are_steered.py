"""What devices tell of hearts that beat out of order, faster and faster, or under way.

Whoever wears them walks and holds the breath besides: all that a device sends is held against what
it measured, and heart rates and intervals against the heart itself.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.quantities import ContentType
from biosensor_gateway.demo.virtual_devices import virtual_names
from biosensor_gateway.devices.registry import declaration
from tests.contracts.conftest import class_of, is_recording
from tests.contracts.test_any_driver import measured, places
from tests.contracts.test_untidy import STAMP_LIMIT_S
from tests.rigs.driver_run import streaming
from tests.rigs.patients import Patient, ectopic, fibrillation, ramp
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

SECONDS, SOON_S = 15.0, 20.0
HEARTS = {
    "steady": Patient(beats_s=ramp(120, 90, 90), walks=((5.0, 15.0),)),
    "fibrillation": Patient(beats_s=fibrillation(200, 95)),
    "ectopic": Patient(beats_s=ectopic(200, 70, 4), walks=((10.0, 20.0),)),
    "ramp": Patient(beats_s=ramp(60, 60, 150), apnoeas=((10.0, 20.0),)),
}
LEARNED = 5
"""So many beats it takes until the delay of a device is known."""
INTERVAL_LIMIT_S = 0.02
"""Of what sensors round, and find among their samples."""


def intervals_of(name: str) -> str:
    """Return the data name of the intervals that a virtual device tells soon; empty if of none."""
    found = class_of(name)
    for each in declaration(found.sensor).streams:
        filled = found.filled.get(each.data_name)
        is_soon = filled is None or (filled.after_s or SOON_S) < SOON_S
        if each.content_type is ContentType.RR and is_soon and not is_recording(name):
            return each.data_name
    return ""


def rates_of(name: str) -> list[str]:
    """Return the data names of the heart rates that a virtual device tells soon."""
    found = class_of(name)
    return [
        each.data_name
        for each in declaration(found.sensor).streams
        if each.content_type is ContentType.HR
        and not each.message_type.is_text
        and (each.data_name not in found.filled or found.filled[each.data_name].after_s is not None)
    ]


TELLING = [each for each in virtual_names() if intervals_of(each)]


@pytest.mark.parametrize("heart", HEARTS)
@pytest.mark.parametrize("name", TELLING, indirect=True)
async def test_intervals_are_those_of_the_heart(
    name: str, make: Make, heart: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    patient = HEARTS[heart]
    with make(wearer=patient) as device:
        for variable, text in device.environment.items():
            monkeypatch.setenv(variable, text)
        data_name = intervals_of(name)
        async with streaming(device) as run:
            await until(run.sink.has(3, data_name))
            await asyncio.sleep(SECONDS)
        told = run.sink.array(data_name)[:, 0]
        truth = device.truth.samples(data_name)
    # What the device says that it found; and that is in the heart.
    count = len(told)
    assert count > 2 * LEARNED
    np.testing.assert_allclose(told, truth.values[:count, 0], rtol=1e-5)
    late_s = np.array(run.sink.times[data_name]) - truth.times[:count]
    limit_s = device.expected.unstamped_s.get(data_name, 0.0) + STAMP_LIMIT_S
    assert np.abs(late_s[LEARNED:]).max() < limit_s
    true = np.diff(np.array(patient.beats_s))
    nearest = np.abs(told[1:, np.newaxis] - true[np.newaxis, :]).min(axis=1)
    assert nearest.max() < INTERVAL_LIMIT_S


RATES = {
    each: streams
    for each in virtual_names()
    if not is_recording(each) and (streams := rates_of(each))
}
RATE_LIMIT_BPM = 2.0
"""Sensors send whole numbers, of means over some beats."""


@pytest.mark.parametrize("heart", HEARTS)
@pytest.mark.parametrize("name", RATES, indirect=True)
async def test_all_that_is_told_was_measured_and_heart_rates_are_those_of_the_heart(
    name: str, make: Make, heart: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    patient = HEARTS[heart]
    with make(wearer=patient) as device:
        switched_on_s = device.world.clock()
        for variable, text in device.environment.items():
            monkeypatch.setenv(variable, text)
        async with streaming(device) as run:
            for data_name in RATES[name]:
                await until(run.sink.has(1, data_name))
            await asyncio.sleep(SECONDS)
        for data_name in {*measured(device), *RATES[name]} - device.expected.by_agent:
            index = places(device, run, data_name)
            assert index or data_name not in RATES[name], data_name
            assert set(np.diff(index)) <= {1}, data_name
        told = {each: run.sink.array(each)[:, 0] for each in RATES[name]}
    # Each device counts time from when it was switched on.
    momentary = patient.heart_rate(np.arange(0.0, run.sink.clock() - switched_on_s, 0.05))
    for data_name, values in told.items():
        known = values[np.isfinite(values)]
        assert len(known), data_name
        assert known.min() > momentary.min() - RATE_LIMIT_BPM, data_name
        fastest = 60.0 / (60.0 / momentary.max() - INTERVAL_LIMIT_S)
        assert known.max() < fastest + RATE_LIMIT_BPM, data_name
        if heart == "ramp":
            assert known[-1] > known[0] or len(known) == 1, data_name
