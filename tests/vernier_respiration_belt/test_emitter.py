"""Which channels are recorded, and what each message puts into which stream."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.vernier_respiration_belt import SPEC
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import (
    BeltChannels,
    choose_channels,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import VernierEmitter
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Channel,
    Measurement,
    MeasurementKind,
    Notice,
    Reply,
    Status,
    Unknown,
)
from tests.rigs.emitter_sink import EmitterSink

# What each message of a belt puts into which stream, and what it does not.

NAN = math.nan
PERIOD_S = 0.1
ARRIVAL_S = 5_000.0
FORCE, RATE = 1, 2
LOOSE, GOOD, TIGHT = -1.0, 0.0, 1.0


class Belt:
    """Sends packets at the pace of measuring to an emitter."""

    def __init__(self, sink: EmitterSink) -> None:
        self.emitter = VernierEmitter(sink)
        self.counter = 0
        self.measured = 0
        self.start()

    def start(self, period_s: float = PERIOD_S) -> None:
        channels = (Channel(number, "", "", 0, 0, 0) for number in (FORCE, RATE))
        self.emitter.started(BeltChannels(*channels), period_s)

    def send(
        self,
        samples: Mapping[int, Sequence[float]],
        kind: MeasurementKind = MeasurementKind.NORMAL_REAL32,
    ) -> None:
        self.measured += max(map(len, samples.values()))
        self.counter = (self.counter + 1) % 256
        held = {channel: tuple(values) for channel, values in samples.items()}
        arrival_s = ARRIVAL_S + self.measured * PERIOD_S
        self.emitter.take(Measurement(self.counter, kind, held), arrival_s)

    def breathe(self, seconds: float, *, mean: float = 12.0, size: float = 2.0) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            force = mean + size * math.sin(self.measured * PERIOD_S * 1.5)
            self.send({FORCE: [force], RATE: [14.0]})


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("vernier_respiration_belt")


@pytest.fixture
def belt(sink: EmitterSink) -> Belt:
    return Belt(sink)


def test_every_sample_of_a_packet_goes_into_both_streams(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [11.5, 11.75], RATE: [14.0, 14.0]})
    belt.send({FORCE: [12.0], RATE: [14.5]})
    assert sink.values("force") == [11.5, 11.75, 12.0]
    assert sink.values("bpm") == [14.0, 14.0, 14.5]
    times = sink.device_times["force"]
    assert sink.device_times["bpm"] == times
    assert np.diff(times).tolist() == pytest.approx([PERIOD_S] * 2)


def test_a_rate_that_is_not_known_yet_keeps_its_place(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [-0.529, -0.532], RATE: [NAN, 14.0]})
    assert sink.values("bpm") == pytest.approx([NAN, 14.0], nan_ok=True)
    assert sink.values("force") == [-0.529, -0.532]


def test_a_missing_force_keeps_its_place(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [NAN], RATE: [14.0]})
    assert sink.values("force") == pytest.approx([NAN], nan_ok=True)


def test_the_device_clock_gets_the_last_sample_of_a_packet(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [1.0, 2.0, 3.0], RATE: [NAN] * 3})
    newest = sink.device_times["force"][-1]
    assert newest + sink.clock_state.offset_s == pytest.approx(ARRIVAL_S + 0.3)


def test_channels_that_are_not_declared_are_passed_over(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [10.0], RATE: [15.0], 4: [3.0], 5: [0.0]})
    belt.send({4: [3.0]}, MeasurementKind.APERIODIC_REAL32)
    assert sink.values("force") == [10.0]
    assert sink.values("bpm") == [15.0]


def test_a_rate_that_comes_alone_is_placed_at_the_newest_force(
    belt: Belt, sink: EmitterSink
) -> None:
    belt.send({FORCE: [10.0, 11.0]}, MeasurementKind.SINGLE_REAL32)
    belt.send({RATE: [15.0]}, MeasurementKind.APERIODIC_REAL32)
    assert sink.values("bpm") == [15.0]
    assert sink.device_times["bpm"] == sink.device_times["force"][-1:]


def test_a_rate_before_the_first_force_has_no_time_and_is_lost(
    belt: Belt, sink: EmitterSink
) -> None:
    belt.send({RATE: [15.0, 16.0]}, MeasurementKind.APERIODIC_REAL32)
    assert sink.emitted == {}
    assert sink.losses == {"bpm": 2}
    belt.send({FORCE: [10.0], RATE: [17.0]})
    assert sink.values("bpm") == [17.0]


@pytest.mark.parametrize(
    "message",
    [
        Reply(1, 0x10, 0xFD, b"\0"),
        Notice(1, MeasurementKind.START_TIME),
        Unknown(1),
        Measurement(1, MeasurementKind.NORMAL_REAL32, {FORCE: (), RATE: ()}),
    ],
)
def test_what_holds_no_samples_emits_nothing(
    message: Reply | Notice | Unknown | Measurement, belt: Belt, sink: EmitterSink
) -> None:
    belt.emitter.take(message, ARRIVAL_S)
    assert sink.emitted == {}


def test_replies_in_between_are_no_lost_packets(belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(5.0)
    belt.counter += 1
    belt.emitter.take(Reply(belt.counter, 0x10, 0xFD, b"\0"), ARRIVAL_S)
    belt.breathe(5.0)
    assert len(sink.values("force")) == 100
    assert sink.losses == {}


def test_lost_packets_are_counted_for_both_streams_and_called_an_estimate(
    belt: Belt, sink: EmitterSink
) -> None:
    belt.breathe(5.0)
    belt.counter += 3
    belt.measured += 3
    with capture_logs() as logs:
        belt.breathe(5.0)
    assert sink.losses == {"force": 3, "bpm": 3}
    assert [(log["event"], log["samples"], log["estimated"]) for log in logs] == [
        ("samples were lost", 3, True)
    ]
    assert sink.device_times["force"][50] - sink.device_times["force"][49] == pytest.approx(0.4)


def test_samples_that_the_belt_says_it_dropped_are_counted(belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(5.0)
    belt.counter += 1
    belt.emitter.take(Notice(belt.counter, MeasurementKind.DROPPED), ARRIVAL_S)
    belt.measured += 2
    belt.breathe(5.0)
    assert sink.losses == {"force": 2, "bpm": 2}


@pytest.mark.parametrize("end", ["ended", "start"])
def test_what_is_held_back_is_emitted_at_the_end(end: str, belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(5.0)
    belt.counter += 1
    belt.breathe(0.2)
    assert len(sink.values("force")) == 50
    belt.emitter.ended() if end == "ended" else belt.start()
    assert len(sink.values("force")) == 52


def test_a_new_start_goes_on_in_time(belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(5.0)
    belt.measured += 20
    belt.counter = 0
    belt.start()
    belt.breathe(1.0)
    assert len(sink.values("force")) == 60
    times = sink.device_times["force"]
    assert times[50] - times[49] == pytest.approx(2.1, abs=0.01)
    assert sink.losses["force"] == 20


def test_battery_and_signal_strength_are_stamped_by_the_host(belt: Belt, sink: EmitterSink) -> None:
    belt.emitter.take_status(Status("1.7.220", "1.9.31", 76, 0), ARRIVAL_S)
    belt.emitter.take_rssi(-61, ARRIVAL_S + 1.0)
    belt.emitter.take_rssi(None, ARRIVAL_S + 2.0)
    assert (sink.values("bat"), sink.values("rssi")) == ([76.0], [-61.0])
    assert (sink.lsl_times["bat"], sink.lsl_times["rssi"]) == ([ARRIVAL_S], [ARRIVAL_S + 1.0])


def test_quality_comes_at_first_on_change_and_every_ten_seconds(
    belt: Belt, sink: EmitterSink
) -> None:
    belt.send({FORCE: [12.0], RATE: [NAN]})
    assert sink.emitted["quality"] == [[0.0, GOOD]]
    belt.send({FORCE: [12.5], RATE: [NAN]})
    assert len(sink.emitted["quality"]) == 1
    belt.send({FORCE: [12.0], RATE: [14.0]})
    assert sink.emitted["quality"] == [[0.0, GOOD], [1.0, GOOD]]
    belt.breathe(30.0)
    assert sink.emitted["quality"][2:] == [[1.0, GOOD]] * 3


@pytest.mark.parametrize(
    ("mean", "size", "tension"),
    [(0.4, 0.1, LOOSE), (12.0, 2.0, GOOD), (45.0, 2.0, TIGHT), (12.0, 0.001, LOOSE)],
)
def test_tension_is_judged_by_the_last_seconds(
    mean: float, size: float, tension: float, belt: Belt, sink: EmitterSink
) -> None:
    belt.breathe(11.0)
    belt.breathe(11.0, mean=mean, size=size)
    assert sink.emitted["quality"][-1] == [1.0, tension]
    belt.breathe(11.0)
    assert sink.emitted["quality"][-1] == [1.0, GOOD]


def test_a_single_slack_sample_is_not_a_loose_belt(belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(5.0)
    belt.send({FORCE: [0.0], RATE: [14.0]})
    belt.breathe(5.0)
    assert all(quality[1] == GOOD for quality in sink.emitted["quality"])


def test_tension_without_any_force_is_unknown_and_said_once(belt: Belt, sink: EmitterSink) -> None:
    belt.send({FORCE: [NAN], RATE: [NAN]})
    belt.send({FORCE: [NAN], RATE: [NAN]})
    assert sink.emitted["quality"] == [pytest.approx([0.0, NAN], nan_ok=True)]


def test_every_declared_stream_is_emitted(belt: Belt, sink: EmitterSink) -> None:
    belt.breathe(1.0)
    belt.emitter.take_status(Status("", "", 50, 0), ARRIVAL_S)
    belt.emitter.take_rssi(-60, ARRIVAL_S)
    assert sink.emitted.keys() == {stream.data_name for stream in SPEC.streams}


# Which channels are recorded, and with which period.
def channel(
    number: int, description: str, least: int = 10_000, most: int = 60_000_000, step: int = 10_000
) -> Channel:
    return Channel(number, description, "", least, most, step)


FORCE_CHANNEL, RATE_CHANNEL = channel(1, "Force"), channel(2, "Respiration Rate")


def test_force_and_rate_are_found_by_name_wherever_they_are() -> None:
    chosen = choose_channels(
        [channel(0, "Steps"), channel(7, "FORCE"), channel(9, "Respiration Rate")]
    )
    assert (chosen.force.number, chosen.rate.number) == (7, 9)
    assert chosen.mask == 0b10_1000_0000


@pytest.mark.parametrize(
    "channels", [[], [FORCE_CHANNEL], [RATE_CHANNEL], [channel(1, "Temperature")]]
)
def test_another_device_is_unsupported(channels: list[Channel]) -> None:
    with pytest.raises(ProtocolError) as caught:
        choose_channels(channels)
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@pytest.mark.parametrize(
    ("wanted_us", "least", "most", "step", "period_us"),
    [
        (100_000, 10_000, 60_000_000, 10_000, 100_000),
        (104_000, 10_000, 60_000_000, 10_000, 100_000),
        (50_000, 75_000, 60_000_000, 10_000, 80_000),
        (900_000, 10_000, 255_000, 10_000, 250_000),
        (100_000, 50_000, 60_000_000, 0, 100_000),
        (100_000, 200_000, 50_000, 10_000, 200_000),
    ],
)
def test_the_period_is_one_that_the_belt_can_have(
    wanted_us: int, least: int, most: int, step: int, period_us: int
) -> None:
    limited = channel(2, "Respiration Rate", least, most, step)
    assert BeltChannels(FORCE_CHANNEL, limited).period_us(wanted_us) == period_us


@given(*[st.integers(1, 2**32 - 1)] * 3, st.integers(50_000, 1_000_000))
def test_any_limits_give_a_period(least: int, most: int, step: int, wanted_us: int) -> None:
    limited = channel(2, "Respiration Rate", least, most, step)
    both = BeltChannels(channel(1, "Force", 1, 2**64 - 1, 1), limited)
    period = both.period_us(wanted_us)
    assert period >= least
    assert period % step == 0
