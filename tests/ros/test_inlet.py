"""An inlet against real outlets: every sample comes once, in order and as it is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pylsl
import pytest
from pylsl import util

from biosensor_common.lsl.inlet import Block, samples_available
from biosensor_common.refusal import Refusals
from lsl_to_ros.lsl.delivery import BATCH_SAMPLES
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.rigs.lsl_streams import (
    DEADLINE_S,
    Collector,
    Open,
    Source,
    drain_until,
    inlets,
    keep_lsl_inlets,
    thread_count,
)
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def open_inlet(warnings: list[str]) -> Iterator[Open]:
    with inlets(warnings.append) as open_:
        yield open_


@pytest.fixture
def lsl_inlets(monkeypatch: pytest.MonkeyPatch) -> list[pylsl.StreamInlet]:
    return keep_lsl_inlets(monkeypatch)


@pytest.mark.seam
@pytest.mark.parametrize(
    ("channel_format", "dtype", "sample"),
    [
        ("float32", np.float32, [0.5, float("nan"), float("inf")]),
        ("double64", np.float64, [0.1, 1e300, -5e-324]),
        ("int32", np.int32, [2**31 - 1, -(2**31), 0]),
        ("int16", np.int16, [2**15 - 1, -(2**15), 0]),
        ("int8", np.int8, [127, -128, 0]),
        ("int64", np.int64, [2**63 - 1, -(2**63), 0]),
    ],
)
@pytest.mark.parametrize("count", [1, 3])
def test_numbers_of_every_format_come_as_they_are(
    open_inlet: Open, channel_format: str, dtype: type[Any], sample: list[Any], count: int
) -> None:
    source = Source(channel_format, len(sample))
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    pushed = np.array([sample] * count, dtype)
    source.await_inlet()
    source.outlet.push_chunk(pushed, [5.0 + number for number in range(count)])
    drain_until(inlet, receiver, count)
    received = np.concatenate([block.samples for block in receiver.blocks])
    assert received.dtype == dtype
    assert received.tobytes() == pushed.tobytes()
    assert receiver.stamps == [5.0 + number for number in range(count)]


@pytest.mark.seam
@pytest.mark.parametrize("count", [1, 3])
def test_text_is_decoded(open_inlet: Open, count: int) -> None:
    source = Source("string", 3)
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    source.await_inlet()
    for _ in range(count):
        source.outlet.push_sample(["Größe ☃".encode(), "Größe".encode("latin-1"), b""], 5.0)
    drain_until(inlet, receiver, count)
    assert receiver.samples == [["Größe ☃", "Größe", ""]] * count


@pytest.mark.parametrize("count", [1, BATCH_SAMPLES, BATCH_SAMPLES + 1, 30 * BATCH_SAMPLES])
def test_what_waits_in_the_inlet_is_drained_in_order(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet], count: int
) -> None:
    source = Source(channels=2)
    inlet, receiver = open_inlet(source.find()), Collector()
    (lsl,) = lsl_inlets
    source.push(count)
    # Nobody has to be there when a sample comes.
    wait_until(lambda: samples_available(lsl) == count, "all samples in the inlet")
    inlet.drain()
    assert receiver.count == 0
    inlet.deliver_to(receiver)
    inlet.drain()
    receiver.assert_all(0, count)
    inlet.drain()
    inlet.peek()
    assert receiver.count == count
    source.push(1)
    wait_until(lambda: samples_available(lsl) == 1, "one more")
    inlet.peek()
    receiver.assert_all(0, count + 1)


def test_a_follower_delivers_what_comes_until_it_is_not_wanted_any_more(open_inlet: Open) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    inlet.deliver_to(receiver)
    assert inlet.wants_each_sample
    follower = threading.Thread(target=inlet.follow, args=(lambda: inlet.wants_each_sample,))
    follower.start()
    for count in (1, 1, 7, 2000, 1):
        source.push(count)
        pushed = source.pushed
        wait_until(lambda pushed=pushed: receiver.count == pushed, "all that was pushed")
    receiver.wants_each_sample = False
    assert not inlet.wants_each_sample
    follower.join(DEADLINE_S)
    assert not follower.is_alive()
    source.push(5)
    drain_until(inlet, receiver, source.pushed)
    receiver.assert_all(0, source.pushed)
    assert inlet.state is InletState.READY


def test_several_that_read_at_once_disturb_no_order(open_inlet: Open) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    is_over = threading.Event()

    def repeat(work: Callable[[], None]) -> None:
        while not is_over.is_set():
            work()

    def follow_a_while() -> None:
        turns = iter(range(5))
        inlet.follow(lambda: next(turns, None) is not None and not is_over.is_set())

    threads = [
        threading.Thread(target=repeat, args=(work,))
        for work in (inlet.drain, inlet.peek, inlet.drain, follow_a_while)
    ]
    for thread in threads:
        thread.start()
    try:
        for count in [1, 3, 50, 1, 700] * 20:
            source.push(count)
        wait_until(lambda: receiver.count >= source.pushed, "all that was pushed")
    finally:
        # Else they would keep two processors busy until the last test has ended.
        is_over.set()
        for thread in threads:
            thread.join(DEADLINE_S)
    receiver.assert_all(0, source.pushed)


def test_each_sample_goes_to_one_of_several_receivers(open_inlet: Open) -> None:
    source = Source()
    inlet = open_inlet(source.find())
    receivers: list[Collector] = []
    starts: list[int] = []
    for count in (10, 2000, 1, 30):
        receiver = Collector()
        inlet.deliver_to(receiver)
        if receivers:
            assert receivers[-1].ends == [0]
        receivers.append(receiver)
        starts.append(source.pushed)
        source.push(count)
        drain_until(inlet, receiver, count)
    for receiver, start, end in zip(receivers, starts, [*starts[1:], source.pushed], strict=True):
        receiver.assert_all(start, end)
    assert receivers[-1].ends == []


def test_a_receiver_that_is_full_leaves_samples_with_lsl(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet]
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    (lsl,) = lsl_inlets
    receiver.is_full = True
    inlet.deliver_to(receiver)
    follower = threading.Thread(target=inlet.follow, args=(lambda: not receiver.count,))
    follower.start()
    source.push(3)
    wait_until(lambda: samples_available(lsl) == 3, "all samples in the inlet")
    inlet.drain()
    inlet.peek()
    assert receiver.count == 0
    receiver.is_full = False
    wait_until(lambda: receiver.count == 3, "all samples")
    follower.join(DEADLINE_S)
    receiver.assert_all(0, 3)


def test_at_the_end_a_full_receiver_gets_the_rest(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet]
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    (lsl,) = lsl_inlets
    receiver.is_full = True
    inlet.deliver_to(receiver)
    source.push(BATCH_SAMPLES + 1)
    wait_until(lambda: samples_available(lsl) == BATCH_SAMPLES + 1, "all samples in the inlet")
    inlet.stop()
    receiver.assert_all(0, BATCH_SAMPLES + 1)


def is_lost(lsl: pylsl.StreamInlet) -> bool:
    """Whether liblsl has noticed that the outlet is gone; pulls nothing."""
    try:
        lsl.time_correction(0.05)
    except util.LostError:
        return True
    except util.TimeoutError:
        return False
    return False


@pytest.mark.seam
@pytest.mark.parametrize("count", [0, 1, 23])
def test_what_lsl_drops_when_an_outlet_dies_is_counted(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet], warnings: list[str], count: int
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    (lsl,) = lsl_inlets
    source.push(7)
    drain_until(inlet, receiver, 7)
    source.push(count)
    wait_until(lambda: samples_available(lsl) == count, "the last samples in the inlet")
    source.end()
    wait_until(lambda: is_lost(lsl), "the loss")
    assert inlet.state is InletState.READY
    inlet.drain()
    assert inlet.state is InletState.ENDING
    wait_until(lambda: inlet.state is InletState.LOST, "its end")
    assert receiver.ends == [count]
    receiver.assert_all(0, 7)
    inlet.drain()
    inlet.peek()
    inlet.follow(lambda: True)
    assert (receiver.ends, receiver.count, warnings) == ([count], 7, [])


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_no_sample_is_neither_delivered_nor_counted_when_an_outlet_dies(
    open_inlet: Open, count: int
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    inlet.deliver_to(receiver)
    follower = threading.Thread(target=inlet.follow, args=(lambda: True,))
    follower.start()
    source.push(count)
    wait_until(lambda: receiver.count == count, "all samples")
    source.end()
    wait_until(lambda: inlet.state is InletState.LOST, "the loss")
    follower.join(DEADLINE_S)
    assert not follower.is_alive()
    assert receiver.ends == [0]
    receiver.assert_all(0, count)


def test_a_receiver_that_fails_ends_the_inlet_with_a_word(
    open_inlet: Open, warnings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()

    def fail(_: Block) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(receiver, "receive", fail)
    inlet.deliver_to(receiver)
    source.push(1)

    def has_failed() -> bool:
        inlet.drain()
        return inlet.state is InletState.FAILED

    wait_until(has_failed, "the failure")
    assert len(receiver.ends) == 1
    (sentence,) = warnings
    assert source.info.name() in sentence
    assert "by nothing" in sentence


@pytest.mark.seam
def test_a_stream_that_ends_before_it_is_open_is_lost(warnings: list[str]) -> None:
    source = Source()
    found = source.find()
    source.end()
    inlet = Inlet(found, Refusals(warnings.append))
    wait_until(lambda: inlet.state is InletState.LOST, "the end of the attempt")
    assert inlet.header is None
    assert warnings == []
    inlet.stop().join(DEADLINE_S)


def test_a_stopped_inlet_has_delivered_what_had_come_and_leaves_no_thread(
    warnings: list[str],
) -> None:
    # One each: an outlet may take an inlet that is gone for one that is there.
    sources = {True: Source(), False: Source()}
    found = {wanted: source.find() for wanted, source in sources.items()}
    python_threads, all_threads = threading.active_count(), thread_count()
    for wants_each_sample, source in sources.items():
        inlet = Inlet(found[wants_each_sample], Refusals(warnings.append))
        receiver = Collector(wants_each_sample=wants_each_sample)
        wait_until(lambda inlet=inlet: inlet.state is InletState.READY, "an inlet that is open")
        inlet.deliver_to(receiver)
        if wants_each_sample:
            threading.Thread(target=inlet.follow, args=(lambda: True,)).start()
        source.push(50)
        drain_until(inlet, receiver, 50)
        closing = inlet.stop()
        assert receiver.ends == [0]
        receiver.assert_all(0, 50)
        closing.join(DEADLINE_S)
        assert not closing.is_alive()
        inlet.drain()
        inlet.peek()
        assert (receiver.count, receiver.ends) == (50, [0])
    wait_until(lambda: threading.active_count() <= python_threads, "no thread of ours")
    wait_until(lambda: thread_count() <= all_threads, "no thread of liblsl's")
    assert warnings == []


def test_an_inlet_that_is_stopped_while_it_opens_leaves_no_thread(warnings: list[str]) -> None:
    source = Source()
    found = source.find()
    all_threads = thread_count()
    for _ in range(5):
        Inlet(found, Refusals(warnings.append)).stop().join(DEADLINE_S)
    wait_until(lambda: thread_count() <= all_threads, "no thread")
    assert warnings == []
