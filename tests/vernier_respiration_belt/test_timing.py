"""Where samples without stamps are placed: after pauses, starts and lost packets."""

from __future__ import annotations

import random
from collections.abc import Sequence
from enum import Enum
from itertools import pairwise
from statistics import fmean
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from biosensor_common.device_clock import DeviceClock
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import BeltChannels
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import (
    HELD_PACKETS,
    LOST_LIMIT_S,
    Arrived,
    Numbering,
    Placed,
    VernierEmitter,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Channel,
    Measurement,
    MeasurementKind,
)
from tests.rigs.emitter_sink import EmitterSink

# A belt that pauses for half a second every few seconds, as one in the field was seen to do.

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


@pytest.mark.parametrize(("own_delay_s", "lost"), [(0.0, 3), (0.35, 0)])
def test_what_this_computer_delayed_is_not_taken_for_lost(own_delay_s: float, lost: int) -> None:
    sink = EmitterSink("vernier_respiration_belt")
    sink.own_delay = lambda: own_delay_s
    emitter = VernierEmitter(sink)
    emitter.started(BeltChannels(*(Channel(k, "", "", 0, 0, 0) for k in (1, 2))), PERIOD_S)
    for number in range(120):
        measured_s = BEGIN_S + number * PERIOD_S
        late_s = 0.3 if 100 <= number < 110 else 0.0
        content = {1: (measured_s,), 2: (14.0,)}
        kind = MeasurementKind.NORMAL_REAL32
        emitter.take(Measurement(number % 256, kind, content), measured_s + late_s)
    emitter.ended()
    assert len(sink.values("force")) == 120
    assert sink.losses.get("force", 0) == lost


# How exact stamps are after a belt was started again, again and again.
START_PERIOD_S, DRIFT = 0.1, 30e-6
JITTER_S = 0.06
FORCE, RATE = 1, 2
STARTS, CONNECTED_S, AWAY_S = 6, 60.0, 8.0
SETTLED_S = 10.0


class Stamp(NamedTuple):
    lsl_s: float
    since_start_s: float
    error_s: float
    drift_ppm: float


class Wearing:
    """A belt that is started again and again; the force is the true time of measuring."""

    def __init__(self, seed: int) -> None:
        self._sink = EmitterSink("vernier_respiration_belt")
        self._emitter = VernierEmitter(self._sink)
        self._random = random.Random(seed)
        self._now_s = 5000.0

    def start(self) -> list[Stamp]:
        """Measure for a while, and go away; return what was stamped."""
        channels = (Channel(number, "", "", 0, 0, 0) for number in (FORCE, RATE))
        self._emitter.started(BeltChannels(*channels), START_PERIOD_S)
        start_s = self._now_s + self._random.uniform(0.0, 1.0)
        stamps: list[Stamp] = []
        arrival_s = 0.0
        for index in range(round(CONNECTED_S / START_PERIOD_S)):
            true_s = start_s + index * START_PERIOD_S * (1 + DRIFT)
            arrival_s = max(arrival_s, true_s + self._random.uniform(0.0, JITTER_S))
            content = {FORCE: (true_s,), RATE: (14.0,)}
            kind = MeasurementKind.NORMAL_REAL32
            self._emitter.take(Measurement(index % 256, kind, content), arrival_s)
            device_s = self._sink.device_times["force"][-1]
            lsl_s, drift_ppm = self._sink.mapped(device_s), self._sink.clock_state.drift_ppm
            stamps.append(Stamp(lsl_s, true_s - start_s, lsl_s - true_s, drift_ppm))
        self._now_s = arrival_s + AWAY_S
        return stamps


@pytest.mark.parametrize("seed", range(4))
def test_by_how_much_a_start_is_late_does_not_pass_for_drift(seed: int) -> None:
    belt = Wearing(seed)
    for _ in range(STARTS):
        stamps = belt.start()
        settled = [stamp for stamp in stamps if stamp.since_start_s > SETTLED_S]
        assert max(abs(stamp.error_s) for stamp in settled) < 0.005
        assert abs(fmean(stamp.error_s for stamp in settled)) < 0.001
        assert settled[-1].drift_ppm == pytest.approx(DRIFT * 1e6, abs=50)


def test_stamps_run_on_over_starts() -> None:
    belt = Wearing(1)
    stamps = [stamp for _ in range(STARTS) for stamp in belt.start()]
    measured = [stamp.lsl_s for stamp in stamps]
    assert measured == sorted(measured)


# Where samples without stamps are placed, when packets get lost, late or stored.
NUMBERING_JITTER_S = 0.04
NUMBERING_DRIFT = 80e-6
WARM_UP = 100


class World:
    """A belt whose sample k is measured after k periods, and a radio that delays packets.

    Sample k has the value k, so that what was placed can be compared with the truth.
    """

    def __init__(self, seed: int, period_s: float = 0.1, samples: int = 1) -> None:
        self.clock = DeviceClock()
        self.numbering = Numbering(lambda: self.clock.state)
        self.numbering.restart(period_s)
        self.placed: list[Placed] = []
        self.period_s = period_s
        self.samples = samples
        self.counter = 0
        self.index = 0
        self.started_s = 5000.0
        self._random = random.Random(seed)
        self._arrival_s = 0.0

    def packet(
        self, *, lost: bool = False, not_before_s: float = 0.0, waited_s: float = 0.0
    ) -> None:
        """Send the next packet; a lost one counts, but does not arrive."""
        values = tuple(map(float, range(self.index, self.index + self.samples)))
        self.index += self.samples
        self.counter = (self.counter + 1) % 256
        if lost:
            return
        sent_s = self.true_s(values[-1]) + self._random.uniform(0.0, NUMBERING_JITTER_S)
        self._arrival_s = max(sent_s + waited_s, self._arrival_s, not_before_s)
        measured = Measurement(self.counter, MeasurementKind.NORMAL_REAL32, {1: values})
        self.numbering.count(self.counter)
        packet = Arrived(measured, self.samples, self._arrival_s, waited_s)
        self.take(self.numbering.place(packet))

    def packets(self, count: int) -> None:
        for _ in range(count):
            self.packet()

    def take(self, placed: list[Placed]) -> None:
        for each in placed:
            self.clock.observe(each.last_s, each.arrival_s)
            self.placed.append(each)

    def true_s(self, index: float) -> float:
        return self.started_s + index * self.period_s * (1 + NUMBERING_DRIFT)

    @property
    def lost(self) -> int:
        return sum(each.lost for each in self.placed)

    def missing_and_misplaced(self) -> tuple[int, list[float]]:
        """Samples missing by the values themselves, and how wrong the steps of time are."""
        missing, wrong = 0, list[float]()
        for before, after in pairwise(self.placed):
            step = after.measurement.samples[1][-1] - before.measurement.samples[1][-1]
            missing += round(step) - self.samples
            wrong.append(abs((after.last_s - before.last_s) - step * self.period_s))
        return missing, wrong


@given(st.integers(0, 9), st.sampled_from([0.05, 0.1, 1.0]), st.integers(1, 3))
def test_undisturbed_samples_are_one_period_apart(seed: int, period_s: float, samples: int) -> None:
    world = World(seed, period_s, samples)
    world.packets(300)
    assert len(world.placed) == 300
    missing, wrong = world.missing_and_misplaced()
    assert (world.lost, missing) == (0, 0)
    assert max(wrong) < 1e-6


@given(st.integers(0, 99), st.sampled_from([0.05, 0.1, 1.0]), st.integers(1, 3), st.integers(1, 25))
def test_lost_packets_are_counted_and_time_goes_on_right(
    seed: int, period_s: float, samples: int, lost: int
) -> None:
    world = World(seed, period_s, samples)
    world.packets(WARM_UP)
    for _ in range(lost):
        world.packet(lost=True)
    world.packets(WARM_UP)
    missing, wrong = world.missing_and_misplaced()
    assert (world.lost, missing) == (lost * samples, lost * samples)
    assert max(wrong) < 1e-6


@given(st.integers(0, 99), st.integers(12, 90), st.integers(0, 90))
def test_of_a_stall_only_what_was_not_stored_is_lost(seed: int, length: int, stored: int) -> None:
    stored = min(stored, length)
    world = World(seed)
    world.packets(WARM_UP)
    end_s = world.true_s(world.index + length)
    for number in range(length):
        world.packet(lost=number >= stored, not_before_s=end_s + 0.002 * number)
        if number >= stored:
            # It was never made into a packet, so it has no number.
            world.counter -= 1
    world.packets(WARM_UP)
    missing, _ = world.missing_and_misplaced()
    assert (world.lost, missing) == (length - stored, length - stored)
    newest = world.placed[-1]
    index = newest.measurement.samples[1][-1] - world.placed[0].measurement.samples[1][-1]
    assert newest.last_s - world.placed[0].last_s == pytest.approx(index * 0.1, abs=1e-6)


@given(st.integers(0, 99), st.integers(20, 150), st.integers(0, 140), st.floats(0.0, 3.0))
def test_a_computer_that_is_slow_to_read_what_was_stored_has_lost_nothing(
    seed: int, stored: int, read: int, pause_s: float
) -> None:
    read = min(read, stored - 1)
    world = World(seed)
    world.packets(WARM_UP)
    awake_s = world.true_s(world.index + stored)
    for number in range(stored):
        late_s = pause_s if number >= read else 0.0
        world.packet(not_before_s=awake_s + 0.002 * number + late_s)
    world.packets(WARM_UP)
    missing, wrong = world.missing_and_misplaced()
    assert (world.lost, missing) == (0, 0)
    assert max(wrong) < 1e-6


@given(st.integers(0, 99), st.integers(5, 40), st.integers(0, 6))
def test_a_busy_computer_has_lost_nothing_and_hides_no_loss(
    seed: int, busy: int, unmeasured: int
) -> None:
    world = World(seed)
    world.packets(WARM_UP)
    # As on a computer with ten times as much to do as it can: each packet waits its turn.
    waits = random.Random(seed)
    for _ in range(busy):
        world.packet(waited_s=waits.uniform(0.25, 0.45))
    world.index += unmeasured
    for _ in range(busy):
        world.packet(waited_s=waits.uniform(0.25, 0.45))
    world.packets(WARM_UP)
    missing, _ = world.missing_and_misplaced()
    assert (world.lost, missing) == (unmeasured, unmeasured)


@given(st.integers(0, 99), st.integers(1, 5))
def test_what_the_counter_tells_is_counted_at_once_on_a_busy_computer(seed: int, lost: int) -> None:
    world = World(seed)
    world.packets(WARM_UP)
    for _ in range(lost):
        world.packet(lost=True)
    for _ in range(HELD_PACKETS):
        world.packet(waited_s=0.08)
    assert world.lost >= lost


@given(st.integers(0, 99))
def test_a_counter_that_counts_something_else_is_not_believed(seed: int) -> None:
    world = World(seed)
    steps = random.Random(seed)
    for _ in range(200):
        world.counter = steps.randrange(0, 256, 3)
        world.packet()
    assert len(world.placed) == 200
    assert world.lost == 0


def test_packets_are_held_back_only_while_it_is_unclear() -> None:
    world = World(1)
    world.packets(WARM_UP)
    world.packet(lost=True)
    for held in range(1, HELD_PACKETS):
        world.packet()
        assert len(world.placed) == WARM_UP, f"{held} held"
    world.packet()
    assert len(world.placed) == WARM_UP + HELD_PACKETS
    world.packet()
    assert len(world.placed) == WARM_UP + HELD_PACKETS + 1


def test_what_is_held_back_is_released_at_the_end() -> None:
    world = World(1)
    world.packets(WARM_UP)
    world.packet(lost=True)
    world.packets(2)
    world.take(world.numbering.release())
    assert len(world.placed) == WARM_UP + 2
    assert world.lost == 1
    assert world.numbering.release() == []


@pytest.mark.parametrize("left", range(1, HELD_PACKETS))
def test_the_last_of_what_was_stored_is_where_the_others_are(left: int) -> None:
    world = World(1)
    world.packets(WARM_UP)
    stored = 4 * HELD_PACKETS + left
    arrival_s = world.true_s(world.index + stored) + 2.0
    for _ in range(stored):
        world.packet(not_before_s=arrival_s)
    world.take(world.numbering.release())
    missing, wrong = world.missing_and_misplaced()
    assert (world.lost, missing, len(world.placed)) == (0, 0, WARM_UP + stored)
    assert max(wrong) < 1e-6


@given(st.integers(0, 99), st.floats(1.0, 50.0))
def test_after_a_new_start_time_goes_on_at_the_hosts_clock(seed: int, gap_s: float) -> None:
    world = World(seed)
    world.packets(WARM_UP)
    before = world.placed[-1]
    world.started_s += gap_s
    world.numbering.restart(world.period_s)
    world.counter = 0
    world.packets(WARM_UP)
    after = world.placed[WARM_UP]
    true_gap_s = world.true_s(WARM_UP) - (world.true_s(WARM_UP - 1) - gap_s)
    assert after.last_s - before.last_s == pytest.approx(true_gap_s, abs=2 * NUMBERING_JITTER_S)
    assert world.lost == after.lost == pytest.approx(true_gap_s / 0.1 - 1, abs=1)


def test_a_belt_that_was_away_for_long_has_lost_nothing() -> None:
    world = World(1)
    world.packets(WARM_UP)
    world.started_s += LOST_LIMIT_S + 1.0
    world.numbering.restart(world.period_s)
    world.packets(WARM_UP)
    assert world.lost == 0
    assert world.placed[WARM_UP].last_s > world.placed[WARM_UP - 1].last_s + LOST_LIMIT_S


def test_samples_of_a_new_start_never_overlap_the_old_ones() -> None:
    world = World(1)
    world.packets(WARM_UP)
    world.numbering.restart(world.period_s)
    world.samples = 3
    world.packet()
    assert world.placed[-1].last_s >= world.placed[-2].last_s + 3 * world.period_s - 1e-9


def test_a_new_period_counts_from_the_start_on() -> None:
    world = World(1)
    world.packets(WARM_UP)
    world.started_s = world.true_s(world.index)
    world.index, world.period_s = 0, 0.05
    world.numbering.restart(0.05)
    world.packets(WARM_UP)
    steps = [after.last_s - before.last_s for before, after in pairwise(world.placed[WARM_UP:])]
    assert steps == pytest.approx([0.05] * (WARM_UP - 1))
