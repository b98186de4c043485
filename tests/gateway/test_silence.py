"""Judges of streams: silence, values that cannot be, clocks that jump."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Generator, Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike
from structlog.testing import capture_logs

from biosensor_common.errors import SpecError
from biosensor_common.naming import source_id
from biosensor_common.quantities import ContentType, MessageType, Unit
from biosensor_common.refusal import LATELY_S, Refusals
from biosensor_common.spec import FROM_DEVICE, ChannelSpec, DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.bluetooth_health.driver import HealthEmitter
from biosensor_gateway.devices.bluetooth_health.driver.services import ROWS
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.silence import (
    LARGEST_STEP_S,
    PATIENCE_S,
    RETRY_S,
    Remedy,
    Silence,
    StreamWatch,
    limits,
)
from biosensor_gateway.streaming.sink import (
    JUMPS_SAID,
    JUMPS_SAID_WITHIN_S,
    DeviceSink,
    JumpReports,
    Jumps,
)
from biosensor_gateway.streaming.stages import AHEAD_LIMIT_S, RIGHT_AGAIN_S, Constants
from biosensor_gateway.system.clock import LslClock
from tests.rigs.virtual_time import SetClock

# The judge of silent streams, on a clock of the test's own.

LIMIT_S = 5.0
TICK_S = 0.25

NOT_PHYSICAL = frozenset(
    {
        Unit.ARBITRARY,
        Unit.BOOLEAN,
        Unit.COUNTS,
        Unit.FRACTION,
        Unit.INDEX,
        Unit.LOCAL_FLUX,
        Unit.NONE,
    }
)
"""Units without plausible bounds: raw numbers of a converter, or a vendor's own scale."""


class SteeredWatch:
    """A watch, and a clock that only the test moves."""

    def __init__(self, *names: str, device_limit_s: float = math.inf) -> None:
        self.now_s = 1000.0
        self.limits_s = dict.fromkeys(names, LIMIT_S)
        self.device_limit_s = device_limit_s
        self.watch = StreamWatch(lambda: self.now_s)
        self.connect()

    def connect(self) -> None:
        self.watch.expect(self.limits_s, self.device_limit_s)

    def run(self, seconds: float, *heard: str, can_enable: bool = True) -> list[Silence]:
        """Let time pass as an agent does that runs; some streams are heard all the time."""
        judged: list[Silence] = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            if heard:
                self.watch.heard(*heard)
            silence = self.watch.judge(can_enable=can_enable)
            if silence is not None:
                judged.append(silence)
        return judged


def remedies(judged: list[Silence]) -> list[tuple[Remedy, set[str]]]:
    return [(each.remedy, set(each.streams)) for each in judged]


def test_limits_follow_from_the_rates() -> None:
    assert limits({"ecg": 250.0, "force": 1.0, "ibi": 0.0}, {"hr": 7.5}, PATIENCE_S) == {
        "ecg": PATIENCE_S,
        "force": 20.0,
        "hr": 7.5,
    }


def test_streams_that_come_are_left_alone() -> None:
    bench = SteeredWatch("ecg", "acc")
    assert bench.run(60, "ecg", "acc") == []
    assert not bench.watch.absent


def test_silent_streams_are_enabled_again_then_the_connection_is_made_again() -> None:
    bench = SteeredWatch("ecg", "acc")
    bench.run(10, "ecg", "acc")
    assert bench.run(LIMIT_S - TICK_S) == []
    (first,) = bench.run(TICK_S)
    assert first == Silence(frozenset({"ecg", "acc"}), LIMIT_S, Remedy.ENABLE)
    assert bench.watch.is_waiting
    assert bench.run(LIMIT_S - TICK_S) == []
    (second,) = bench.run(TICK_S)
    assert second == Silence(frozenset({"ecg", "acc"}), 2 * LIMIT_S, Remedy.RECONNECT)
    # A reason stays, over the new connection, until data come.
    bench.connect()
    assert bench.watch.absent == {"ecg", "acc"}
    bench.watch.heard("ecg")
    assert (bench.watch.absent, bench.watch.take_came_back()) == ({"acc"}, {"ecg"})
    assert not bench.watch.take_came_back()


def test_a_driver_without_the_hook_costs_the_connection() -> None:
    bench = SteeredWatch("ecg")
    assert remedies(bench.run(LIMIT_S, can_enable=False)) == [(Remedy.RECONNECT, {"ecg"})]


def test_each_stream_is_judged_by_itself() -> None:
    bench = SteeredWatch("ecg", "acc")
    assert remedies(bench.run(LIMIT_S, "acc")) == [(Remedy.ENABLE, {"ecg"})]
    assert bench.run(1.0, "acc", "ecg") == []
    assert bench.watch.take_came_back() == {"ecg"}
    assert not bench.watch.absent
    assert not bench.watch.is_waiting
    # And again: what came back counts again.
    assert remedies(bench.run(LIMIT_S, "acc")) == [(Remedy.ENABLE, {"ecg"})]


def test_one_stream_that_stays_away_costs_the_others_one_connection_only() -> None:
    bench = SteeredWatch("ecg", "acc")
    judged = bench.run(2 * LIMIT_S, "acc")
    bench.connect()
    judged += bench.run(2 * LIMIT_S + RETRY_S + 2 * LIMIT_S, "acc")
    assert remedies(judged) == [
        (Remedy.ENABLE, {"ecg"}),
        (Remedy.RECONNECT, {"ecg"}),
        (Remedy.ENABLE, {"ecg"}),
        (Remedy.NONE, {"ecg"}),
        (Remedy.ENABLE, {"ecg"}),
        (Remedy.NONE, {"ecg"}),
    ]
    assert bench.watch.absent == {"ecg"}


def test_where_nothing_comes_connections_go_on_being_made() -> None:
    bench = SteeredWatch("ecg", "acc")
    attempts: list[int] = []
    for _ in range(4):
        attempts += [each.attempts for each in bench.run(2 * LIMIT_S)]
        bench.connect()
    assert attempts == [0, 0, 1, 1, 2, 2, 3, 3]


def test_patience_with_all_streams_may_be_shorter_for_a_while() -> None:
    bench = SteeredWatch("ecg", "acc")
    bench.run(1, "ecg", "acc")
    bench.now_s += 1.0
    assert bench.watch.judge(can_enable=True) is None
    (silence,) = [bench.watch.judge(can_enable=True, patience_s=1.0)]
    assert silence == Silence(frozenset({"ecg", "acc"}), 1.0, Remedy.ENABLE)
    bench.watch.heard("ecg", "acc")
    bench.now_s += 1.0
    assert bench.watch.judge(can_enable=True) is None


def test_the_agent_sleeps_and_nothing_is_missed_for_it() -> None:
    bench = SteeredWatch("ecg", device_limit_s=10.0)
    bench.run(4)
    bench.now_s += 3600.0
    assert not bench.watch.is_device_silent
    # The hour counts as one step; then what waited in buffers has its time.
    assert bench.run(LIMIT_S - 4 - LARGEST_STEP_S - TICK_S) == []
    assert bench.run(1, "ecg") == []
    assert not bench.watch.absent


def test_a_starved_agent_gives_no_connection_up() -> None:
    bench = SteeredWatch("ecg", device_limit_s=10.0)
    for _ in range(4):
        bench.now_s += 30.0
        assert bench.watch.judge(can_enable=True) is None
    assert not bench.watch.is_device_silent


def test_what_is_excused_is_not_due_until_it_is_heard() -> None:
    bench = SteeredWatch("hr", "ecg")
    bench.watch.excuse(["hr", "unknown"])
    assert bench.run(10 * LIMIT_S, "ecg") == []
    bench.run(TICK_S, "hr", "ecg")
    assert remedies(bench.run(LIMIT_S, "ecg")) == [(Remedy.ENABLE, {"hr"})]


def test_what_the_device_refuses_is_missing_and_not_waited_for_until_it_comes() -> None:
    bench = SteeredWatch("hr", "ecg")
    bench.run(2 * LIMIT_S, "hr")
    bench.watch.expect(bench.limits_s, denied={"ecg": "no room", "ibi": "no room"})
    assert bench.watch.denied == {"ecg": "no room", "ibi": "no room"}
    assert (bench.watch.absent, bench.watch.is_complete) == (frozenset(), False)
    assert bench.run(2 * RETRY_S, "hr") == []
    bench.run(TICK_S, "hr", "ecg")
    assert (bench.watch.denied, bench.watch.take_came_back()) == ({"ibi": "no room"}, {"ecg"})
    assert remedies(bench.run(LIMIT_S, "hr")) == [(Remedy.ENABLE, {"ecg"})]
    bench.watch.heard("ecg", "ibi")
    assert bench.watch.is_complete
    # What comes when it happens is not due for having been refused once.
    assert bench.run(RETRY_S, "hr", "ecg") == []


def test_what_is_not_due_never_counts() -> None:
    bench = SteeredWatch("ecg")
    bench.watch.heard("ibi")
    assert bench.run(60, "ecg") == []
    assert bench.watch.take_came_back() == frozenset()


def test_a_pause_gives_every_stream_its_time_again() -> None:
    bench = SteeredWatch("ecg")
    for _ in range(20):
        bench.run(LIMIT_S - TICK_S)
        bench.watch.wait_again()
    assert remedies(bench.run(LIMIT_S)) == [(Remedy.ENABLE, {"ecg"})]


def test_what_a_new_connection_does_not_have_is_not_missed() -> None:
    bench = SteeredWatch("ecg")
    bench.run(2 * LIMIT_S)
    bench.watch.expect({})
    assert not bench.watch.absent


@pytest.mark.parametrize("heard", [(), ("ecg",)])
def test_a_device_that_says_anything_is_there(heard: tuple[str, ...]) -> None:
    bench = SteeredWatch(device_limit_s=10.0)
    bench.run(9)
    bench.watch.heard(*heard)
    bench.run(9)
    assert not bench.watch.is_device_silent
    bench.run(1)
    assert bench.watch.is_device_silent
    assert bench.watch.device_silence_s == pytest.approx(10.0)


# What cannot be is not sent, but counted and said: for every sensor, by its declaration.
CHANNELS = [
    pytest.param(channel, id=f"{name}/{stream.data_name}/{channel.label}")
    for name in declaration_names()
    for stream in declaration(name).streams
    for channel in stream.channels
]


class _Time(LslClock):
    """A clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class _Sent:
    """A sink, and what it sent."""

    def __init__(self, sensor: str) -> None:
        self.time = _Time()
        self.sink = DeviceSink(DeviceIdentity(sensor, "1"), declaration(sensor), self.time)
        self.rows: dict[str, list[list[float]]] = {}
        self.sink.tap = self._take
        streams = self.sink.spec.streams
        self.sink.open(
            DeviceInfo(), {each.data_name: 100.0 for each in streams if each.rate == FROM_DEVICE}
        )

    def emit(self, data_name: str, samples: ArrayLike) -> None:
        """Emit samples of now."""
        self.sink.emit_at(data_name, samples, [self.time.now_s] * len(np.asarray(samples)))

    def counters(self, data_name: str) -> Counters:
        return self.sink.counters[source_id(self.sink.identity, data_name)]

    def status(self) -> str:
        """Return what is said of the device."""
        device = Device(Supervisor(lambda: pytest.fail("nobody connects"), self.sink), self.sink)
        told = device.status()
        assert told.error is None
        return "; ".join(
            f"{source.rpartition('-')[2]}: {each.sentence}"
            for source, stream in sorted(told.streams.items())
            for each in stream.refusals
            if each.now
        )

    def _take(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        rows = np.asarray(samples, np.float64).reshape(len(stamps), -1)
        self.rows.setdefault(data_name, []).extend(rows.tolist())


@pytest.mark.parametrize("channel", CHANNELS)
def test_what_has_a_physical_unit_has_bounds_or_says_why_not(channel: ChannelSpec) -> None:
    assert channel.unit not in set(Unit) or (channel.plausible is None) == (
        channel.unit in NOT_PHYSICAL
    )


BOUNDED = [
    pytest.param(name, stream, id=f"{name}/{stream.data_name}")
    for name in declaration_names()
    for stream in declaration(name).streams
    if any(channel.bounds for channel in stream.channels)
]


@pytest.mark.parametrize(("sensor", "stream"), BOUNDED)
def test_each_bound_of_each_declaration_is_kept(sensor: str, stream: StreamSpec) -> None:
    usual = [sum(each.bounds) / 2 if each.bounds else 0.0 for each in stream.channels]
    for column, channel in enumerate(stream.channels):
        if channel.bounds is None:
            continue
        low, high = channel.bounds
        if stream.message_type is MessageType.UINT8:
            high = min(high, 255.0)
        # Integers have no value between a bound and the next whole number.
        step = max(1.0, 1e-3 * max(abs(low), abs(high)))
        for value in (low - step, high + step, low, high):
            sent, row = _Sent(sensor), usual.copy()
            row[column] = value
            sent.emit(stream.data_name, [row])
            told = [each[column] for each in sent.rows.get(stream.data_name, ())]
            is_kept = low <= value <= high
            # Beats that follow each other too fast are refused for another reason.
            assert (value in told) is is_kept or stream.content_type is ContentType.RR
            assert sent.counters(stream.data_name).refused == (value not in told)
            assert sent.status().startswith(f"{stream.data_name}: ") is (value not in told)
            sent.sink.close()


def test_bounds_without_a_value_between_them_are_none() -> None:
    with pytest.raises(SpecError, match="between 3 and 2 there is no value"):
        ChannelSpec("speed", Unit.METRES_PER_SECOND, plausible=(3.0, 2.0))


def test_a_value_that_cannot_be_is_left_out_counted_and_said() -> None:
    sent = _Sent("bluetooth_health")
    with capture_logs() as logs:
        for speed in (9.04e9, 9.1e9, 3.0):
            sent.emit("cycling", [[speed, 90.0]])
        sent.emit("temp", [1e127])
    assert str(sent.rows["cycling"]) == "[[nan, 90.0], [nan, 90.0], [3.0, 90.0]]"
    assert "temp" not in sent.rows
    assert (sent.counters("cycling").refused, sent.counters("cycling").pushed) == (2, 3)
    assert (sent.counters("temp").refused, sent.counters("temp").pushed) == (1, 0)
    assert sent.status() == (
        "cycling: 2 samples were not sent: speed was 9.1e+09 m/s, which is not between 0 and 50; "
        "temp: 1 sample was not sent: body was 1e+127 celsius, which is not between -50 and 100"
    )
    # Once for each stream.
    assert [entry["data"] for entry in logs] == ["cycling", "temp"]
    sent.time.now_s += LATELY_S + 1
    assert sent.status() == ""
    sent.sink.close()


def test_a_regular_stream_keeps_its_pace() -> None:
    sent = _Sent("polar_h10")
    sent.emit("acc", [[0.0, 0.0, 1.0], [math.inf, 0.0, 1e30], [0.0, 0.0, 1.0]])
    sent.emit("ecg", [1.0, 1e9, 2.0])
    assert str(sent.rows["acc"][1]) == "[nan, 0.0, nan]"
    assert str(sent.rows["ecg"]) == "[[1.0], [nan], [2.0]]"
    assert (sent.counters("acc").refused, sent.counters("ecg").refused) == (1, 1)
    sent.sink.close()


def test_whole_numbers_that_cannot_be_are_left_out() -> None:
    sent = _Sent("zephyr")
    sent.emit("hr", [400, 70])
    assert sent.rows["hr"] == [[70.0]]
    assert sent.counters("hr").refused == 1
    sent.sink.close()


@pytest.mark.parametrize("step", [1, 400_000], ids=["backwards", "again"])
def test_a_wheel_whose_count_steps_back_has_no_speed(step: int) -> None:
    sent = _Sent("bluetooth_health")
    emitter = HealthEmitter(sent.sink, 2.105)
    row = next(row for row in ROWS if row.stream == "cycling")
    count = 457371
    for second, turns in enumerate((0, 2, -step, 2, 2)):
        count += turns
        sent.time.now_s += 1.0
        emitter.take(row, struct.pack("<BIH", 1, count, 1024 * (second + 1)), sent.time.now_s)
    assert [speed for speed, _ in sent.rows["cycling"]] == pytest.approx([4.21] * 3)
    assert sent.counters("cycling").refused == 1
    assert f"speed was {-2.105 * step:g} m/s" in sent.status()
    sent.sink.close()


def test_a_wheel_whose_event_time_steps_back_has_no_speed() -> None:
    sent = _Sent("bluetooth_health")
    emitter = HealthEmitter(sent.sink, 2.105)
    row = next(row for row in ROWS if row.stream == "cycling")
    for count, ticks in ((100, 2000), (102, 3024), (104, 2512), (106, 3536)):
        sent.time.now_s += 1.0
        emitter.take(row, struct.pack("<BIH", 1, count, ticks), sent.time.now_s)
    assert [speed for speed, _ in sent.rows["cycling"]] == pytest.approx([4.21] * 2)
    assert sent.counters("cycling").refused == 1
    assert "speed was -8.42 m/s" in sent.status()
    sent.sink.close()


def _pulse(emitter: StrapEmitter, intervals_s: Sequence[float], now_s: float) -> None:
    values = [round(1024 * each) for each in intervals_s]
    emitter.measurement(struct.pack(f"<BB{len(values)}H", 0x10, 72, *values), now_s)


def _beats(sent: _Sent, seconds: int, repeated: int) -> float:
    """Have a strap repeat so many intervals in each packet; return the sum of what was sent."""
    emitter, heart = StrapEmitter(sent.sink), np.random.default_rng(3)
    history, next_s = list[float](), 0.8
    for second in range(1, seconds):
        sent.time.now_s += 1.0
        new = list[float]()
        while next_s <= second:
            new.append(0.8 + 0.05 * float(heart.random()))
            next_s += new[-1]
        history += new
        told = history[-(len(new) + repeated) :] if repeated else new
        _pulse(emitter, told, sent.time.now_s)
    return sum(interval for (interval,) in sent.rows["ibi"])


@pytest.mark.parametrize("repeated", [1, 2])
def test_intervals_that_are_told_twice_are_not_sent_for_long(repeated: int) -> None:
    sent = _Sent("ble_heart_rate")
    assert _beats(sent, 300, repeated) < 2 * AHEAD_LIMIT_S + 20
    assert sent.counters("ibi").refused > 300
    assert "intervals between beats add up to more than the time that has passed" in sent.status()
    sent.sink.close()


def test_beats_of_a_strap_that_repeats_them_no_longer_are_believed_again() -> None:
    sent = _Sent("ble_heart_rate")
    _beats(sent, 60, 1)
    refused, before = sent.counters("ibi").refused, len(sent.rows["ibi"])
    _beats(sent, 240, 0)
    assert refused > 60
    assert len(sent.rows["ibi"]) - before > (240 - 2 * RIGHT_AGAIN_S - 5) / 0.825
    refused = sent.counters("ibi").refused
    _beats(sent, 60, 0)
    assert sent.counters("ibi").refused == refused
    sent.sink.close()


@pytest.mark.parametrize("repeated", [1, 2])
def test_a_strap_that_repeats_beats_is_noticed_after_a_few_and_what_was_sent_is_told(
    repeated: int,
) -> None:
    sent = _Sent("ble_heart_rate")
    _beats(sent, 12, repeated)
    told = [value for (value,) in sent.rows["ibi"]]
    twice = len(told) - len(set(told))
    assert 0 < twice <= 4
    assert f"so some were reported twice; {twice} reported twice before were sent" in sent.status()
    sent.sink.close()


def test_what_was_sent_twice_is_counted_over_all_times_at_which_a_strap_repeated_beats() -> None:
    sent, told = _Sent("ble_heart_rate"), list[int]()
    for repeated, seconds in ((1, 12), (0, 240), (1, 12)):
        _beats(sent, seconds, repeated)
        found = re.search(r"; (\d+) reported twice before were sent", sent.status())
        told.append(int(found[1]) if found else 0)
    assert 0 < told[0] < told[2]
    sent.sink.close()


@pytest.mark.parametrize("seed", range(20))
def test_beats_of_a_pacemaker_that_arrive_in_bundles_are_believed(seed: int) -> None:
    # Each is like the one before.
    sent, chance = _Sent("ble_heart_rate"), np.random.default_rng(seed)
    due_s = sent.time.now_s
    for _ in range(200):
        count = int(chance.integers(1, 5))
        due_s += 0.75 * count
        sent.time.now_s = max(sent.time.now_s, due_s + float(chance.uniform(0.0, 0.5)))
        sent.emit("ibi", [0.75] * count)
    assert sent.counters("ibi").refused == 0
    sent.sink.close()


def test_intervals_of_a_heart_are_believed_also_after_a_pause_and_what_was_stored() -> None:
    sent = _Sent("ble_heart_rate")
    assert _beats(sent, 300, 0) == pytest.approx(298, abs=3)
    sent.time.now_s += 40.0
    sent.emit("ibi", [0.8] * 48)
    for _ in range(100):
        sent.time.now_s += 0.8
        sent.emit("ibi", [0.8])
    assert sent.counters("ibi").refused == 0
    assert sent.status() == ""
    sent.sink.close()


# A device's clock that jumps all the time floods neither the log nor the events.
@pytest.fixture
def clock() -> SetClock:
    return SetClock()


@pytest.fixture
def said() -> list[Jumps]:
    return []


@pytest.fixture
def reports(clock: SetClock, said: list[Jumps]) -> JumpReports:
    return JumpReports(clock, said.append)


@pytest.fixture
def sink(clock: SetClock, unit: str) -> Generator[DeviceSink]:
    made = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"), clock)
    made.open(DeviceInfo(), {})
    yield made
    made.close()


def test_few_are_said_one_by_one(reports: JumpReports, said: list[Jumps]) -> None:
    reports.note("below", 1.5)
    reports.note("device_restarted", None)
    assert said == [Jumps("below", 1.5), Jumps("device_restarted", None)]


def test_many_are_said_together_when_their_time_has_come(
    reports: JumpReports, said: list[Jumps], clock: SetClock
) -> None:
    for number in range(JUMPS_SAID + 500):
        clock.now_s += 0.01
        reports.note("below" if number % 2 else "device_backward", -3.0 if number % 2 else 3.5)
        reports.release()
    assert len(said) == JUMPS_SAID
    del said[:]
    clock.now_s += JUMPS_SAID_WITHIN_S
    reports.release()
    ((cause, seconds, times),) = said
    assert (cause, times) == ("device_backward", 500)
    assert seconds == pytest.approx(250 * 0.5)
    reports.release()
    assert len(said) == 1


def test_what_is_not_said_yet_is_said_at_the_end(reports: JumpReports, said: list[Jumps]) -> None:
    for _ in range(JUMPS_SAID + 2):
        reports.note("below", 1.0)
    reports.note("device_restarted", None)
    reports.finish()
    reports.finish()
    assert said[JUMPS_SAID:] == [Jumps("device_restarted", None, 3)]


def test_a_clock_that_jumps_there_and_back_is_said_a_few_times_and_counted_always(
    sink: DeviceSink,
) -> None:
    with capture_logs() as logs:
        for number in range(1000):
            sink.observe(8.2e8 + 3600.0 * (number % 2), 1000.0 + 0.01 * number)
        sink.close()
    told = [entry for entry in logs if "jumped" in entry["event"]]
    assert sink.clock_state.reanchors == 999
    assert [entry.get("times", 1) for entry in told] == [1] * JUMPS_SAID + [999 - JUMPS_SAID]


# A signal of a body that has one value for long comes from a dead electrode, not from a body.
RATE_HZ = 10


def flat_of(
    sensor: str, data_name: str, seconds: Sequence[Sequence[float]]
) -> list[tuple[int, str]]:
    """Send one row of values for each second; return from when on which sentence stands."""
    constants, refusals = Constants(declaration(sensor)), Refusals(clock=lambda: 0.0)
    told: list[tuple[int, str]] = []
    for second, row in enumerate(seconds):
        rows = np.tile(np.array(row, np.float64), (RATE_HZ, 1))
        stamps = second + np.arange(RATE_HZ) / RATE_HZ
        constants.note(data_name, rows, stamps.tolist(), refusals)
        said = next((each.sentence for each in refusals.present), "")
        if said != (told[-1][1] if told else ""):
            told.append((second, said))
    return told


def test_a_dead_electrode_among_others_is_named_until_it_lives_again() -> None:
    rows = [[0.0, second, -second, second % 2] for second in range(30)]
    rows += [[second % 3, 7.0, 7.0, second] for second in range(30)]
    told = flat_of("muse", "eeg", rows)
    assert [said.partition(" not changed")[0] for _, said in told] == [
        "TP9 (0 microvolts) has",
        "",
        "AF7 (7 microvolts), AF8 (7 microvolts) have",
    ]
    assert told[0][0] in (10, 11)
    assert told[1][0] in (30, 31)
    assert "check electrode" in told[0][1]


@pytest.mark.parametrize(
    ("sensor", "data_name", "row"),
    [
        ("muse", "aux", [0.0] * 4),
        ("polar_h10", "acc", [0.0, 0.0, 1.0]),
        ("polar_h10", "hr", [64.0]),
        ("polar_h10", "bat", [80.0]),
        ("muse", "eeg", [math.nan] * 4),
        ("empatica_e4", "st", [32.5]),
    ],
)
def test_what_may_be_constant_is_no_remark(sensor: str, data_name: str, row: list[float]) -> None:
    assert not flat_of(sensor, data_name, [row] * 200)


def test_a_slow_signal_has_more_time() -> None:
    assert not flat_of("empatica_e4", "gsr", [[0.0]] * 55)
    ((second, said),) = flat_of("empatica_e4", "gsr", [[0.0]] * 70)
    assert second in (60, 61)
    assert "60 s or longer" in said


def test_two_equal_values_around_a_gap_are_no_flat_signal() -> None:
    constants, refusals = Constants(declaration("polar_h10")), Refusals()
    for stamp in (0.0, 20.0, 40.0):
        constants.note("ecg", [5.0], [stamp], refusals)
    assert not refusals.present


def test_of_a_stream_that_does_not_send_nothing_is_said() -> None:
    constants, refusals = Constants(declaration("polar_h10")), Refusals()
    for second in range(15):
        constants.note("ecg", [5.0, 5.0], [second, second + 0.5], refusals)
    constants.look(15.0)
    assert refusals.present
    constants.look(20.5)
    assert not refusals.present
    # It is said again once it sends again for long.
    for second in range(30, 45):
        constants.note("ecg", [5.0, 5.0], [second, second + 0.5], refusals)
    assert refusals.present
