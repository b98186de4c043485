"""Frames that come twice or in another order, as reported in polar-ble-sdk #387."""

from __future__ import annotations

import pytest

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from tests.polar_h10.test_emitter import COUNT, ECG, START_S, arrival, ecg
from tests.rigs.emitter_sink import EmitterSink


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("polar_h10")


def taken(sink: EmitterSink, *numbers: int) -> list[int]:
    """Take frames in, each as soon as the newest is complete; return whose samples were emitted."""
    emitter, newest = PolarEmitter(sink), 0
    emitter.started(ECG, 130, 1.0)
    for number in numbers:
        newest = max(newest, number)
        emitter.frame(ecg(number), arrival(newest))
    return [int(value) for value in sink.values("ecg")[::COUNT]]


def test_a_copy_is_left_out_and_said(sink: EmitterSink) -> None:
    assert taken(sink, 0, 1, 1, 2, 0, 3) == [0, 1, 2, 3]
    expected = [START_S + (k + 1) / 130 for k in range(4 * COUNT)]
    assert sink.device_times["ecg"] == pytest.approx(expected, abs=1e-6)
    assert (sink.losses, sink.refusals.count(Refusal.LEFT_OUT)) == ({}, 2 * COUNT)
    assert sink.refusals.all[0].sentence == f"{2 * COUNT} samples were left out: they came twice"


def test_what_comes_behind_a_later_one_is_lost_once_and_no_stamp_goes_back(
    sink: EmitterSink,
) -> None:
    assert taken(sink, 0, 2, 1, 3, 4) == [0, 2, 3, 4]
    times = sink.device_times["ecg"]
    assert times == sorted(times)
    assert sink.losses == {"ecg": COUNT}
    assert sink.refusals.count(Refusal.LEFT_OUT) == COUNT


def test_a_clock_that_was_set_back_goes_on_with_its_second_frame(sink: EmitterSink) -> None:
    assert taken(sink, 5, 6, 1, 2, 3, 4) == [5, 6, 2, 3, 4]
    assert sink.refusals.count(Refusal.LEFT_OUT) == COUNT
