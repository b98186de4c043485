"""What devices tell of hearts that beat out of order, faster and faster, or under way."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.quantities import ContentType
from biosensor_gateway.demo.virtual_devices import virtual_names
from biosensor_gateway.devices.registry import declaration
from tests.contracts.conftest import class_of, is_recording
from tests.contracts.test_untidy import STAMP_LIMIT_S
from tests.rigs.driver_run import streaming
from tests.rigs.patients import Patient, ectopic, fibrillation, ramp
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

SECONDS, SOON_S = 15.0, 20.0
HEARTS = {
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
