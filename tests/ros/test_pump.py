"""Every inlet is read, by whichever thread; no sample is lost or misplaced on a change."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from lsl_to_ros.lsl.inlets import MOST_FOLLOWERS, Inlet, InletState, Pump
from tests.rigs.lsl_streams import Collector, Open, Source, inlets, thread_count
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly


class Stream(NamedTuple):
    source: Source
    inlet: Inlet
    receiver: Collector


class Streams:
    """Streams that a pump reads."""

    def __init__(self, open_inlet: Open) -> None:
        self.all: list[Stream] = []
        self._open = open_inlet
        self.pump = Pump(lambda: [stream.inlet for stream in self.all])

    def add(self, *, wants_each_sample: bool = False) -> Stream:
        source = Source()
        inlet = self._open(source.find())
        stream = Stream(source, inlet, Collector(wants_each_sample=wants_each_sample))
        inlet.deliver_to(stream.receiver)
        self.all.append(stream)
        return stream

    def push(self, count: int) -> None:
        for stream in self.all:
            stream.source.push(count)

    @property
    def followed(self) -> list[Stream]:
        """Those that have a thread each."""
        running = {thread.name for thread in threading.enumerate()}
        return [it for it in self.all if f"follow {it.source.info.name()}" in running]

    def settle(self) -> None:
        """Wait until every sample is where it belongs."""
        for stream in self.all:
            wait_until(
                lambda stream=stream: stream.receiver.count == stream.source.pushed,
                "all that was pushed",
            )
            stream.receiver.assert_all(0, stream.source.pushed)
            assert stream.inlet.state is InletState.READY


@pytest.fixture
def open_inlet() -> Iterator[Open]:
    with inlets(pytest.fail) as open_:
        yield open_


@pytest.fixture
def streams(open_inlet: Open) -> Iterator[Streams]:
    streams = Streams(open_inlet)
    yield streams
    streams.pump.stop()


def shared() -> list[str]:
    """Names of running threads that read several streams."""
    return [it.name for it in threading.enumerate() if it.name in ("drain", "peek")]


def test_what_nobody_wants_at_once_is_drained(streams: Streams) -> None:
    for _ in range(3):
        streams.add()
    streams.pump.look()
    for count in (1, 5000, 7):
        streams.push(count)
        streams.settle()
    assert streams.followed == []


def test_each_of_a_few_that_are_wanted_at_once_has_its_thread(streams: Streams) -> None:
    for _ in range(MOST_FOLLOWERS):
        streams.add(wants_each_sample=True)
    streams.pump.look()
    streams.pump.look()
    assert streams.followed == streams.all
    for count in (1, 1, 300, 1):
        streams.push(count)
        streams.settle()


def test_many_that_are_wanted_at_once_share_one(streams: Streams) -> None:
    for _ in range(MOST_FOLLOWERS + 2):
        streams.add(wants_each_sample=True)
    streams.pump.look()
    assert streams.followed == []
    for count in (1, 1, 300, 1):
        streams.push(count)
        streams.settle()


def test_those_of_a_few_give_way_to_the_one_of_many(streams: Streams) -> None:
    for _ in range(MOST_FOLLOWERS):
        streams.add(wants_each_sample=True)
    streams.pump.look()
    assert streams.followed == streams.all
    one_more = streams.add(wants_each_sample=True)
    streams.pump.look()
    wait_until(lambda: not streams.followed, "the end of the threads of single streams")
    streams.push(3)
    streams.settle()
    one_more.receiver.wants_each_sample = False
    streams.pump.look()
    wait_until(lambda: "peek" not in shared(), "the end of the thread of many")
    assert streams.followed == streams.all[:-1]
    streams.push(3)
    streams.settle()


def test_an_inlet_that_is_not_open_yet_is_left_alone(streams: Streams) -> None:
    stream = streams.add(wants_each_sample=True)
    stream.inlet.state = InletState.OPENING
    streams.pump.look()
    assert streams.followed == []
    stream.inlet.state = InletState.READY
    streams.pump.look()
    streams.push(3)
    streams.settle()


@pytest.mark.seam
def test_no_sample_is_lost_however_often_readers_come_and_go(streams: Streams) -> None:
    for _ in range(MOST_FOLLOWERS + 2):
        streams.add()
    is_over = threading.Event()

    def push() -> None:
        while not is_over.wait(0.001):
            streams.push(3)

    pushing = threading.Thread(target=push)
    pushing.start()
    # Nobody, a few, a crowd, and back; each for long enough that threads begin and end.
    for readers in (0, 2, MOST_FOLLOWERS, MOST_FOLLOWERS + 2, 3, MOST_FOLLOWERS + 1, 0, 1) * 2:
        for place, stream in enumerate(streams.all):
            stream.receiver.wants_each_sample = place < readers
        streams.pump.look()
        is_over.wait(0.12)
    is_over.set()
    pushing.join()
    assert streams.all[0].source.pushed > 100
    for stream in streams.all:
        stream.receiver.wants_each_sample = False
    streams.pump.look()
    streams.settle()
    wait_until(lambda: not streams.followed, "the end of what nobody wants")


def test_a_stream_that_ends_disturbs_no_other(streams: Streams) -> None:
    first, second = streams.add(wants_each_sample=True), streams.add(wants_each_sample=True)
    drained = streams.add()
    streams.pump.look()
    streams.push(5)
    streams.settle()
    for stream in (first, drained):
        stream.source.end()
        wait_until(lambda stream=stream: stream.inlet.state is InletState.LOST, "the loss")
        assert len(stream.receiver.ends) == 1
    streams.pump.look()
    streams.all[:] = [second]
    streams.pump.look()
    streams.push(5)
    streams.settle()


def test_a_stopped_pump_leaves_no_thread(open_inlet: Open) -> None:
    before = thread_count()
    for count in (0, 2, MOST_FOLLOWERS + 2):
        streams = Streams(open_inlet)
        for _ in range(count):
            streams.add(wants_each_sample=True)
        streams.pump.look()
        streams.push(3)
        streams.settle()
        streams.pump.stop()
        assert shared() == []
        for stream in streams.all:
            stream.inlet.stop().join()
            stream.source.end()
    wait_until(lambda: thread_count() <= before, "no thread more than before")
