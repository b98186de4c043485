"""How a stream ends: what LSL drops is counted, and nothing of it stays behind."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pylsl
import pytest
from pylsl import util

from biosensor_common.lsl.inlet import Block, samples_available
from biosensor_common.refusals import Refusals
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
    wait_until,
)

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
