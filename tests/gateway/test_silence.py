"""The judge of silent streams, on a clock of the test's own."""

from __future__ import annotations

import math

import pytest

from biosensor_gateway.streaming.silence import (
    LARGEST_STEP_S,
    PATIENCE_S,
    RETRY_S,
    Remedy,
    Silence,
    StreamWatch,
    limits,
)

LIMIT_S = 5.0
TICK_S = 0.25


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
