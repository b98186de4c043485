"""What samples of Cortex become: values, losses and repetitions."""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.refusal import Refusal
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.emotiv_insight.driver.emitter import EmotivEmitter, SampleCount
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Sample
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.driver_run import NotedSink

# What samples of Cortex become.

START_S = 1.7e9
EEG = {"COUNTER": 0.0, "INTERPOLATED": 0.0, "AF3": 4201.5, "T7": 4202.5, "Pz": 4203.5,
       "T8": 4204.5, "AF4": 4205.5, "RAW_CQ": 1024.0, "MARKER_HARDWARE": 1.0}  # fmt: skip
QUATERNION = {"Q0": 1.0, "Q1": 0.0, "Q2": 0.0, "Q3": 0.0}
GYROSCOPE = {"GYROX": 8192.0, "GYROY": 8180.0, "GYROZ": 8201.0}
FIELD = {"ACCX": 0.0, "ACCY": -1.0, "ACCZ": 0.1, "MAGX": 30.0, "MAGY": -15.0, "MAGZ": 45.0}


@pytest.fixture
def sink() -> Generator[NotedSink]:
    opened = NotedSink("emotiv_insight")
    opened.open(DeviceInfo(), {"mot": 64.0, "gyro": 64.0})
    yield opened
    opened.close()


@pytest.fixture
def emitter(sink: NotedSink) -> EmotivEmitter:
    made = EmotivEmitter(sink)
    made.connected(128.0, 64.0, headset_stayed=True)
    return made


def take(
    emitter: EmotivEmitter,
    stream: str,
    numbers: dict[str, float],
    number: float = 0.0,
    others: dict[str, Any] | None = None,
) -> None:
    emitter.take(Sample(stream, START_S + number, numbers, others or {}), LSL_CLOCK())


def row(sink: NotedSink, data_name: str) -> list[float | None]:
    """Return the only sample of a stream, None for "no value"."""
    (values,) = sink.rows[data_name]
    return [None if math.isnan(value) else round(float(value), 6) for value in values]


def test_eeg_keeps_its_offset_and_its_status_goes_beside(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    take(emitter, "eeg", EEG, others={"MARKERS": [{"label": "x"}]})
    assert row(sink, "eeg") == [4201.5, 4202.5, 4203.5, 4204.5, 4205.5]
    assert row(sink, "eeg_status") == [0, 0, 1024, 1]
    assert sink.device_times["eeg"] == sink.device_times["eeg_status"] == [START_S]


def test_an_electrode_that_is_missing_or_null_is_no_value(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    take(emitter, "eeg", {"T7": 4200.0, "T8": math.nan, "F7": 1.0, "COUNTER": 3.0})
    assert row(sink, "eeg") == [None, 4200.0, None, None, None]
    assert row(sink, "eeg_status") == [3, None, None, None]


def test_a_regular_sample_without_any_value_keeps_its_place(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    take(emitter, "eeg", dict.fromkeys(EEG, math.nan))
    take(emitter, "pow", {"AF3/theta": math.nan})
    take(emitter, "mot", {"ACCX": math.nan})
    assert row(sink, "eeg") == [None] * 5
    assert row(sink, "pow") == [None] * 25
    assert row(sink, "mot") == [None] * 10


@pytest.mark.parametrize("stream", ["met", "dev"])
def test_an_irregular_sample_without_any_value_is_not_sent(
    emitter: EmotivEmitter, sink: NotedSink, stream: str
) -> None:
    take(emitter, stream, {"eng": math.nan, "AF3": math.nan, "Battery": -1.0})
    assert sink.rows[stream] == []
    assert not any(counters.refused for counters in sink.counters.values())


def test_newer_firmware_has_an_orientation(emitter: EmotivEmitter, sink: NotedSink) -> None:
    take(emitter, "mot", {**QUATERNION, **FIELD, "COUNTER_MEMS": 0.0})
    assert row(sink, "mot") == [1, 0, 0, 0, 0, -1, 0.1, 30, -15, 45]
    assert sink.rows["gyro"] == []


def test_older_firmware_has_a_gyroscope_instead(emitter: EmotivEmitter, sink: NotedSink) -> None:
    take(emitter, "mot", {**GYROSCOPE, **FIELD, "COUNTER_MEMS": 0.0})
    take(emitter, "mot", {**GYROSCOPE, **FIELD, "COUNTER_MEMS": 3.0}, 3 / 64)
    assert sink.rows["gyro"][0] == [8192, 8180, 8201]
    assert sink.rows["mot"][0][4:] == [0, -1, 0.1, 30, -15, 45]
    assert all(math.isnan(value) for value in sink.rows["mot"][0][:4])
    assert sink.losses == {"mot": 2, "gyro": 2}


def test_band_powers_go_by_label(emitter: EmotivEmitter, sink: NotedSink) -> None:
    labels = [f"{electrode}/{band}" for electrode in ("AF3", "T7", "Pz", "T8", "AF4")
              for band in ("theta", "alpha", "betaL", "betaH", "gamma")]  # fmt: skip
    values = {label: float(index) for index, label in enumerate(labels)}
    take(emitter, "pow", dict(reversed(values.items())))
    assert row(sink, "pow") == [float(index) for index in range(25)]


def test_metrics_are_told_by_name_whatever_the_version(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    numbers = {"eng": 0.6, "exc": 0.3, "lex": 0.2, "str": 0.5, "rel": math.nan, "int": 0.9,
               "attention": 0.0}  # fmt: skip
    take(emitter, "met", numbers, others={"rel.isActive": False, "int.isActive": False})
    assert row(sink, "met") == [0.6, 0.3, 0.2, 0.5, None, None, None, 0.0]


@pytest.mark.parametrize(("percent", "expected"), [(88.0, 88.0), (0.0, 0.0), (-1.0, None)])
def test_a_battery_that_is_not_known_is_no_value(
    emitter: EmotivEmitter, sink: NotedSink, percent: float, expected: float | None
) -> None:
    take(emitter, "dev", {"Battery": -1.0, "Signal": 1.0, "AF3": 4.0, "BatteryPercent": percent})
    assert row(sink, "dev") == [None, 1, 4, None, None, None, None, None, expected]


def test_what_is_computed_late_does_not_move_the_clock(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    take(emitter, "eeg", EEG, 10.0)
    before = sink.clock_state.observations
    take(emitter, "met", {"eng": 0.5}, 0.0)
    take(emitter, "dev", {"Signal": 1.0}, 5.0)
    assert sink.clock_state.observations == before == 1
    assert sink.clock_state.reanchors == 0


def test_without_eeg_and_motion_the_others_are_the_clock(
    emitter: EmotivEmitter, sink: NotedSink
) -> None:
    take(emitter, "dev", {"Signal": 1.0})
    assert len(sink.rows["dev"]) == sink.clock_state.observations == 1


def test_a_sample_that_comes_twice_is_sent_once(emitter: EmotivEmitter, sink: NotedSink) -> None:
    take(emitter, "eeg", EEG)
    take(emitter, "eeg", EEG)
    assert len(sink.rows["eeg"]) == sink.refusals.count(Refusal.LEFT_OUT) == 1
    assert not sink.losses


@pytest.mark.parametrize("stayed", [True, False])
def test_a_gap_between_connections_is_an_estimate_if_the_headset_has_measured(
    emitter: EmotivEmitter, sink: NotedSink, stayed: bool
) -> None:
    arrival = LSL_CLOCK() - 5
    emitter.take(Sample("eeg", START_S, EEG), arrival)
    with capture_logs() as logs:
        emitter.connected(128.0, 64.0, headset_stayed=stayed)
        for late_s in (2.0, 3.0):
            emitter.take(Sample("eeg", START_S + late_s, EEG), arrival + late_s)
    between, within = (255, 127) if stayed else (0, 127)
    assert sink.lost_count("eeg") == between + within
    estimates = [entry["samples"] for entry in logs if "estimate" in entry["event"]]
    assert estimates == ([255] if stayed else [])


def test_streams_without_a_place_are_left_out(emitter: EmotivEmitter, sink: NotedSink) -> None:
    take(emitter, "eq", {"overall": 100.0})
    assert not any(sink.rows.values())


# Losses and repetitions, from counter and time.
NAN = math.nan


class Feed:
    """Feeds samples of one long recording, by their number."""

    def __init__(self, rate_hz: float = 128.0, *, counted: bool = True) -> None:
        self.count = SampleCount(rate_hz)
        self._rate, self._counted = rate_hz, counted

    def __call__(self, number: int, step_s: float = 0.0) -> int | None:
        time_s = round(START_S + number / self._rate + step_s, 4)
        counter = number % round(self._rate) if self._counted else NAN
        return self.count.lost_before(counter, time_s, number / self._rate)


@given(
    st.lists(st.integers(1, 2000), min_size=1, max_size=20),
    st.sampled_from([32.0, 64.0, 128.0, 256.0]),
    st.booleans(),
)
def test_every_loss_is_found(steps: list[int], rate_hz: float, counted: bool) -> None:
    feed, number = Feed(rate_hz, counted=counted), 5
    assert feed(number) == 0
    for step in steps:
        number += step
        assert feed(number) == step - 1


@given(st.integers(1, 300), st.integers(0, 60))
def test_what_comes_twice_is_known(sent: int, back: int) -> None:
    feed = Feed()
    for number in range(sent + 1):
        feed(number)
    again = max(0, sent - back)
    assert [feed(number) for number in range(again, sent + 1)] == [None] * (sent + 1 - again)
    assert feed(sent + 1) == 0


@pytest.mark.parametrize("step_s", [-3600.0, -30.0, -1.0, -0.5, 0.5, 1.0, 5.0, 3600.0])
def test_a_clock_that_is_set_loses_nothing(step_s: float) -> None:
    feed = Feed()
    assert [feed(0), feed(1)] == [0, 0]
    assert [feed(2, step_s), feed(3, step_s), feed(6, step_s)] == [0, 0, 2]
    assert feed(6 + 129, step_s) == 128


def test_a_clock_that_is_set_in_a_gap_hides_no_loss() -> None:
    feed = Feed()
    feed(0)
    assert feed(1 + 3 * 128, 3600.0) == 3 * 128
    uncounted = Feed(counted=False)
    uncounted(0)
    assert uncounted(1 + 3 * 128, 3600.0) == 3 * 128


@given(st.lists(st.floats(0.0, 5.0), min_size=2, max_size=50), st.floats(-150e-6, 150e-6))
def test_late_arrivals_and_a_drifting_clock_are_no_losses(
    delays_s: list[float], drift: float
) -> None:
    count, arrival_s = SampleCount(128.0), 0.0
    for number, delay_s in enumerate(delays_s):
        time_s = number / 128
        arrival_s = max(arrival_s, time_s * (1 + drift) + delay_s)
        if number == 0:
            arrival_s = 0.0
        assert count.lost_before(number % 128, START_S + time_s, arrival_s) == 0


def test_a_counter_that_does_not_survive_a_connection_leaves_the_time() -> None:
    feed = Feed()
    feed(0)
    feed.count.reconnected()
    assert feed.count.lost_before(77, START_S + 3.0, 3.0) == 3 * 128 - 1
    assert feed.count.lost_before(78, START_S + 3.0 + 1 / 128, 3.0) == 0


def test_nothing_is_known_of_the_time_in_which_the_headset_was_off() -> None:
    feed = Feed()
    feed(0)
    feed.count.forget()
    assert feed(100_000) == 0


def test_a_day_is_no_gap() -> None:
    feed = Feed()
    feed(0)
    feed.count.reconnected()
    assert feed(128 * 100_000) == 0


@pytest.mark.parametrize("counter", [NAN, math.inf, -1.0, 200.0, 3.5])
def test_a_counter_that_cannot_be_is_left_out(counter: float) -> None:
    count = SampleCount(64.0)
    assert count.lost_before(counter, START_S, 0.0) == 0
    assert count.lost_before(counter, START_S + 4 / 64, 4 / 64) == 3


def test_a_fractional_rate_has_no_known_counter() -> None:
    count = SampleCount(6.4)
    assert count.lost_before(5, START_S, 0.0) == 0
    assert count.lost_before(0, START_S + 2 / 6.4, 0.3) == 1
