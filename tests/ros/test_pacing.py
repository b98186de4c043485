"""Bursts are spread, in order and complete, and nothing else waits for them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from std_msgs.msg import Float32, String

from lsl_to_ros.topics.lanes import (
    AT_ONCE,
    BACKLOG,
    MOST_WAITING,
    TAKEN_WITHIN_S,
    TICK_S,
    Lane,
    Pace,
    Pacer,
)

PER_MS, BURST = 0.5, 73


class Topic:
    """One topic, whose messages are numbers as bytes; notes when each went out."""

    def __init__(self, bench: SteeredPacer, rate: float, piece: int) -> None:
        self.sent: list[tuple[float, int]] = []
        self.is_taken = True
        self._bench, self._came = bench, 0
        self.lane = Lane(self._publish, lambda: self.is_taken, bench.pacer, rate=rate, piece=piece)

    @property
    def times(self) -> list[float]:
        return [time_s for time_s, _ in self.sent]

    @property
    def numbers(self) -> list[int]:
        return [number for _, number in self.sent]

    def come(self, samples: int) -> None:
        """Let so many samples come at once."""
        begin, self._came = self._came, self._came + samples
        self.lane.send([str(number).encode() for number in range(begin, self._came)])

    def expect_all(self) -> None:
        """Everything went out, in its order."""
        assert self.numbers == list(range(self._came))
        assert self.lane.waiting == 0

    def _publish(self, message: bytes) -> None:
        self.sent.append((self._bench.now_s, int(message)))


class SteeredPacer:
    """A pacer whose time and turns are the test's."""

    def __init__(self, per_ms: float = PER_MS) -> None:
        self.now_s = 100.0
        self.warnings: list[str] = []
        self.pace = Pace(per_ms)
        self.pacer = Pacer(self.pace, self.warnings.append, lambda: self.now_s)

    def topic(self, rate: float = 130.0, piece: int = MOST_WAITING) -> Topic:
        return Topic(self, rate, piece)

    def run(self, seconds: float, turn_s: float = TICK_S) -> None:
        """Let time go by, with a turn of the pacer every so often."""
        for _ in range(round(seconds / turn_s)):
            self.now_s += turn_s
            self.pacer.turn()


def test_what_comes_alone_goes_out_at_once() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    for _ in range(50):
        topic.come(1)
        assert topic.lane.waiting == 0
        bench.now_s += 1 / 130
    topic.expect_all()
    assert bench.pacer.turn() is None


def test_a_burst_is_spread() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(BURST)
    assert len(topic.sent) == AT_ONCE
    bench.run(0.2)
    topic.expect_all()
    later = topic.times[AT_ONCE - 1 :]
    gaps = [b - a for a, b in pairwise(later)]
    assert gaps == pytest.approx([0.001 / PER_MS] * (BURST - AT_ONCE))


def test_what_comes_while_others_wait_goes_out_behind_them() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    for _ in range(20):
        topic.come(BURST)
        bench.run(0.05)
    bench.run(20.0)
    topic.expect_all()


@pytest.mark.parametrize("late_s", [0.01, 0.1, 1.0])
def test_a_late_turn_makes_no_new_burst(late_s: float) -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(BURST)
    bench.now_s += late_s
    bench.pacer.turn()
    assert len(topic.sent) == 2 * AT_ONCE


def test_a_long_silence_earns_no_larger_burst() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(1)
    bench.now_s += 3600.0
    topic.come(BURST)
    assert len(topic.sent) == 1 + AT_ONCE


@pytest.mark.parametrize("rate", [256.0, 1000.0, 10_000.0])
def test_an_even_stream_never_waits(rate: float) -> None:
    bench = SteeredPacer()
    topic = bench.topic(rate)
    for _ in range(500):
        bench.now_s += TICK_S
        topic.come(max(1, round(rate * TICK_S)))
        assert topic.lane.waiting == 0
    topic.expect_all()


@pytest.mark.parametrize("rate", [256.0, 1000.0, 10_000.0])
@pytest.mark.parametrize("turn_s", [0.002, 0.02])
def test_no_stream_falls_behind(rate: float, turn_s: float) -> None:
    bench = SteeredPacer()
    topic = bench.topic(rate)
    for _ in range(100):
        topic.come(round(0.1 * rate))
        bench.run(0.1, turn_s)
    assert topic.lane.waiting < rate
    bench.run(5.0, turn_s)
    topic.expect_all()


def test_one_topic_s_backlog_does_not_hold_up_another() -> None:
    bench = SteeredPacer()
    long, short = bench.topic(), bench.topic()
    long.come(5000)
    short.come(BURST)
    bench.run(0.2)
    short.expect_all()
    alone = SteeredPacer()
    topic = alone.topic()
    topic.come(BURST)
    alone.run(0.2)
    assert short.times == topic.times


@pytest.mark.parametrize("samples", [500, 9000])
def test_a_backlog_goes_out_while_its_stream_goes_on(samples: int) -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(samples)
    for _ in range(80):
        bench.run(0.1)
        topic.come(13)
    bench.run(0.1)
    topic.expect_all()


@pytest.mark.parametrize("rate", [64.0, 250.0, 512.0])
def test_what_5_s_have_held_up_is_gone_within_2_s(rate: float) -> None:
    bench = SteeredPacer()
    topic = bench.topic(rate)
    topic.come(round(5 * rate))
    for _ in range(20):
        topic.come(round(rate / 10))
        bench.run(0.1)
    assert topic.lane.waiting <= rate / 10


def test_without_pacing_all_goes_out_at_once() -> None:
    bench = SteeredPacer(0.0)
    topic = bench.topic()
    topic.come(BURST)
    topic.expect_all()


def test_pacing_can_be_switched_off_while_something_waits() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(BURST)
    bench.pace.per_ms = 0.0
    bench.run(TICK_S)
    topic.expect_all()


@given(
    steps=st.lists(st.tuples(st.integers(0, 90), st.integers(0, 200)), max_size=8),
    rate=st.sampled_from([0.0, 1.0, 130.0, 250.0]),
)
def test_no_queue_is_overrun_whatever_comes(steps: Sequence[tuple[int, int]], rate: float) -> None:
    assume(sum(samples for samples, _ in steps) <= BACKLOG)
    bench = SteeredPacer()
    topic = bench.topic(rate)
    for samples, milliseconds in steps:
        topic.come(samples)
        bench.run(milliseconds / 1000, 0.001)
    bench.run(2.0, 0.001)
    topic.expect_all()
    # What goes out in 20 ms; a subscriber that takes one in 2 ms has no more than AT_ONCE to queue.
    most = AT_ONCE + round(20 * PER_MS)
    spans = [b - a for a, b in zip(topic.times, topic.times[most:], strict=False)]
    assert all(span_s > 0.0199 for span_s in spans)


def test_a_publisher_s_queue_is_not_overrun() -> None:
    bench = SteeredPacer(0.0)
    topic = bench.topic(piece=100)
    topic.is_taken = False
    topic.come(250)
    assert len(topic.sent) == 100
    bench.run(TAKEN_WITHIN_S / 2)
    assert len(topic.sent) == 100
    topic.is_taken = True
    bench.run(0.1)
    topic.expect_all()


def test_a_subscriber_that_has_stopped_is_waited_for_once() -> None:
    bench = SteeredPacer(0.0)
    topic = bench.topic(piece=100)
    topic.is_taken = False
    topic.come(1000)
    bench.run(TAKEN_WITHIN_S + 0.1)
    topic.expect_all()
    topic.come(1000)
    topic.expect_all()


def test_what_goes_out_before_it_can_be_taken_is_counted() -> None:
    bench = SteeredPacer(0.0)
    topic = bench.topic(piece=100)
    topic.come(250)
    assert (topic.lane.sent, topic.lane.not_taken) == (250, 0)
    topic.is_taken = False
    topic.come(250)
    bench.run(TAKEN_WITHIN_S + 0.1)
    topic.expect_all()
    assert (topic.lane.sent, topic.lane.not_taken) == (500, 200)


def test_the_oldest_message_of_a_lane_has_an_age() -> None:
    bench = SteeredPacer()
    topic = bench.topic(0.0)
    topic.come(AT_ONCE)
    assert topic.lane.age_s == 0.0
    bench.pace.per_ms = 0.001
    topic.come(AT_ONCE)
    bench.now_s += 0.5
    topic.come(AT_ONCE)
    assert topic.lane.age_s == pytest.approx(0.5)
    bench.run(10.0)
    topic.expect_all()
    assert topic.lane.age_s == 0.0


def test_a_lane_says_when_its_stream_should_stay_in_lsl_s_buffer() -> None:
    bench = SteeredPacer()
    topic = bench.topic()
    topic.come(MOST_WAITING)
    assert not topic.lane.is_full
    topic.come(AT_ONCE)
    assert topic.lane.is_full
    bench.run(0.1)
    assert not topic.lane.is_full
    bench.run(20.0)
    topic.expect_all()


def lane_of(bench: SteeredPacer, publish: Callable[[Any], None]) -> Lane:
    return Lane(publish, lambda: True, bench.pacer, rate=130.0, piece=MOST_WAITING)


def test_what_cannot_be_a_message_fails_where_it_is_sent() -> None:
    bench, sent = SteeredPacer(), list[String]()
    lane = lane_of(bench, sent.append)
    lane.send([String(data=str(number)) for number in range(10)])
    with pytest.raises(UnicodeEncodeError):
        lane.send([String(data="\ud800")])
    lane.send([String(data="10")])
    bench.run(1.0)
    assert [message.data for message in sent] == [str(number) for number in range(11)]


def test_what_waits_does_not_change_with_its_message() -> None:
    bench, sent = SteeredPacer(), list[Any]()
    lane = lane_of(bench, sent.append)
    message = Float32(data=1.0)
    lane.send([message] * (AT_ONCE + 1))
    message.data = 2.0
    bench.run(0.1)
    assert sent[-1].data == 1.0


def test_what_ros_fails_to_publish_is_counted_and_costs_nothing_else() -> None:
    bench, sent = SteeredPacer(), list[bytes]()

    def publish(message: bytes) -> None:
        if message == b"7":
            raise RuntimeError("the queue is full")
        sent.append(message)

    lane = lane_of(bench, publish)
    lane.send([str(number).encode() for number in range(10)])
    bench.run(0.1)
    assert [int(message) for message in sent] == [0, 1, 2, 3, 4, 5, 6, 8, 9]
    assert lane.unsent == 1
    assert len(bench.warnings) == 1


@pytest.mark.nightly
def test_what_waits_at_the_end_goes_out_in_order() -> None:
    pacer = Pacer(Pace(PER_MS), pytest.fail)
    sent, threads = list[int](), set[str]()

    def publish(message: bytes) -> None:
        sent.append(int(message))
        threads.add(threading.current_thread().name)

    lane = Lane(publish, lambda: True, pacer, rate=0.0, piece=MOST_WAITING)
    pacer.start()
    lane.send([str(number).encode() for number in range(3000)])
    pacer.stop()
    assert sent == list(range(3000))
    assert threads == {"pace", threading.current_thread().name}
