"""What a bridge publishes, drops and counts of the samples that it is given."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from std_msgs.msg import Float32, Float32MultiArray, UInt8

from biosensor_common.lsl.inlet import Block
from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.refusal import Refusals
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.lsl.inlets import MOST_FOLLOWERS, Inlet, InletState, Pump
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.statistics.losses import FOREIGN_JITTER_S, NodeCounters
from lsl_to_ros.topics.bridge import Bridge, Outputs
from lsl_to_ros.topics.outputs import CLASSES
from lsl_to_ros.topics.writers import ChunkWriter, NumberWriter
from tests.rigs.lsl_streams import Collector, Open, Source, inlets, thread_count
from tests.rigs.polling import wait_until
from tests.rigs.recorded_topics import Clocks, RecordedPublisher, header_of

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = pytest.mark.nightly

HEADER = header_of("zephyr", "ecg", rate=100.0)
ON = StreamSettings(raw=True, chunk=True, chunk_length=4)


class Setup:
    """A bridge of one channel with a raw topic and, if the header says so, chunks."""

    def __init__(self, ros: Ros, header: StreamHeader, settings: StreamSettings) -> None:
        self.raw = RecordedPublisher(CLASSES[header.message_type])
        self.chunk = RecordedPublisher(Float32MultiArray, "biosensors/zephyr/ecg_chunk")
        self.warnings: list[str] = []
        self.counters = NodeCounters(refusals=Refusals(self.warnings.append, "zephyr ecg"))
        refusals = self.counters.refusals
        outputs = Outputs(raw=NumberWriter(self.raw, header.message_type, 1, refusals))
        if header.chunk:
            outputs.chunk = ChunkWriter(self.chunk, MessageType.FLOAT32_MULTI_ARRAY, 1)
        self.bridge = Bridge(header, outputs, settings, self.counters, Clocks(ros.node))

    def send(self, *values: float, start: float = 1000.0, step: float = 0.01) -> None:
        """Send samples one by one."""
        for number, value in enumerate(values):
            self.send_block([value], [start + number * step])

    def send_block(self, values: list[float], stamps: list[float]) -> None:
        dtype = {
            ChannelFormat.FLOAT32: np.float32,
            ChannelFormat.INT16: np.int16,
        }[self.bridge.header.format]
        self.bridge.receive(Block(np.array(values, dtype)[:, np.newaxis], np.array(stamps)))


Make = Callable[..., Setup]


@pytest.fixture
def make(ros: Ros) -> Make:
    def setup(header: StreamHeader = HEADER, settings: StreamSettings = ON) -> Setup:
        return Setup(ros, header, settings)

    return setup


@pytest.mark.seam
def test_every_sample_goes_out_at_once_and_in_its_chunk(make: Make) -> None:
    it = make()
    it.send(1, 2, 3, 4, 5)
    assert it.raw.values == [1, 2, 3, 4, 5]
    assert it.chunk.values == [[1, 2, 3, 4]]
    assert (it.counters.received, it.counters.missing, it.counters.discarded) == (5, 0, 0)


def test_a_block_is_no_different(make: Make) -> None:
    it = make()
    it.send_block([1, 2, 3, 4, 5], [1000 + number * 0.01 for number in range(5)])
    assert it.raw.values == [1, 2, 3, 4, 5]
    assert it.chunk.values == [[1, 2, 3, 4]]
    assert it.counters.received == 5


@pytest.mark.seam
@pytest.mark.parametrize("as_block", [False, True])
def test_a_chunk_never_spans_a_gap(make: Make, as_block: bool) -> None:
    it = make()
    stamps = [1000.0, 1000.01, 1000.02, 1000.12, 1000.13, 1000.14, 1000.15]
    values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    if as_block:
        it.send_block(values, stamps)
    else:
        for value, stamp in zip(values, stamps, strict=True):
            it.send_block([value], [stamp])
    assert it.raw.values == [1, 2, 3, 4, 5, 6, 7]
    assert it.chunk.values == [[4, 5, 6, 7]]
    assert (it.counters.discarded, it.counters.missing) == (3, 9)


@pytest.mark.seam
@settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    steps=st.lists(st.sampled_from([0.01, 0.01, 0.01, 0.01, 0.05, 1.0]), max_size=40),
    cuts=st.sets(st.integers(1, 40)),
)
def test_what_comes_in_blocks_is_published_and_counted_as_if_it_came_singly(
    make: Make, steps: list[float], cuts: set[int]
) -> None:
    stamps = [1000.0]
    for step in steps:
        stamps.append(stamps[-1] + step)
    values = [float(number) for number in range(len(stamps))]
    singly, together = make(), make()
    for value, stamp in zip(values, stamps, strict=True):
        singly.send_block([value], [stamp])
    edges = sorted({0, len(stamps), *(cut for cut in cuts if cut < len(stamps))})
    for start, end in pairwise(edges):
        together.send_block(values[start:end], stamps[start:end])
    assert together.raw.values == singly.raw.values == values
    assert together.chunk.values == singly.chunk.values
    for counter in ("received", "missing", "discarded", "unfit", "unstamped"):
        assert getattr(together.counters, counter) == getattr(singly.counters, counter)
    in_chunks = sum(len(chunk) for chunk in singly.chunk.values)
    singly.bridge.end(0)
    assert in_chunks + singly.counters.discarded == len(values)


def test_a_stamp_that_is_a_little_late_is_no_gap(make: Make) -> None:
    it = make()
    it.send(1, 2, 3, 4, step=0.0149)
    assert len(it.chunk.messages) == 1
    assert (it.counters.missing, it.counters.discarded) == (0, 0)


def test_stamps_of_other_programs_may_jitter(make: Make) -> None:
    it = make(replace(HEADER, foreign=True))
    it.send(1, 2, 3, 4, step=FOREIGN_JITTER_S * 0.9)
    assert len(it.chunk.messages) == 1
    it.send(5, 6, step=FOREIGN_JITTER_S * 2.0, start=1001.0)
    assert it.counters.missing > 0


def test_an_irregular_stream_has_no_gaps(make: Make) -> None:
    it = make(replace(HEADER, rate=0.0, chunk=""))
    it.send(1, 2, 3, step=60.0)
    assert it.raw.values == [1, 2, 3]
    assert (it.counters.received, it.counters.missing) == (3, 0)


@pytest.mark.parametrize("stamp", [math.inf, -math.inf, math.nan, 1e308, 0.0, -5.0])
@pytest.mark.parametrize("as_block", [False, True])
def test_no_stamp_stops_a_stream(make: Make, stamp: float, as_block: bool) -> None:
    it = make(replace(HEADER, rate=1e300))
    it.send(1)
    if as_block:
        it.send_block([2.0, 3.0], [stamp, 1000.01])
    else:
        it.send_block([2.0], [stamp])
        it.send(3, start=1000.01)
    assert it.raw.values == [1, 2, 3]
    assert it.counters.received == 3


def test_a_sample_that_does_not_fit_is_counted_and_said_once(make: Make) -> None:
    it = make(replace(HEADER, message_type=MessageType.UINT8, format=ChannelFormat.INT16))
    it.send_block([60, 300, -1, 61], [1000.0, 1000.01, 1000.02, 1000.03])
    it.send(62, 256, start=1000.04)
    assert it.raw.values == [60, 61, 62]
    assert it.counters.unfit == 3
    assert len(it.warnings) == 1
    assert "zephyr ecg" in it.warnings[0]
    assert "300" in it.warnings[0]


def test_a_sample_that_does_not_fit_the_raw_message_is_still_in_its_chunk(make: Make) -> None:
    it = make(replace(HEADER, message_type=MessageType.UINT8, format=ChannelFormat.INT16))
    assert it.raw.type_name == f"std_msgs/msg/{UInt8.__name__}"
    it.send(1, 300, 3, 4)
    assert it.chunk.values == [[1, 300, 3, 4]]


def test_the_raw_topic_alone_can_be_silenced(make: Make) -> None:
    it = make(settings=replace(ON, raw=False))
    it.send(1, 2, 3, 4)
    assert it.raw.messages == []
    assert len(it.chunk.messages) == 1


def test_silenced_chunks_leave_nothing_behind(make: Make) -> None:
    it = make()
    it.send(1, 2)
    it.bridge.settings = replace(ON, chunk=False)
    it.send(3, 4, start=1000.02)
    it.bridge.settings = ON
    it.send(5, 6, 7, 8, start=1000.04)
    assert it.raw.values == [1, 2, 3, 4, 5, 6, 7, 8]
    assert it.chunk.values == [[5, 6, 7, 8]]
    assert it.counters.discarded == 2


def test_a_new_chunk_length_holds_from_the_next_sample_on(make: Make) -> None:
    it = make()
    it.send(1, 2, 3)
    it.bridge.settings = replace(ON, chunk_length=2)
    it.send(4, start=1000.03)
    it.bridge.settings = replace(ON, chunk_length=3)
    it.send(5, 6, 7, start=1000.04)
    assert it.chunk.values == [[1, 2], [3, 4], [5, 6, 7]]
    assert it.counters.discarded == 0


def test_what_nobody_reads_is_not_published_but_counted(make: Make) -> None:
    it = make()
    it.raw.set_readers(0)
    it.chunk.set_readers(0)
    it.send(1, 2, 3, 4)
    assert it.raw.messages == it.chunk.messages == []
    assert it.counters.received == 4


def test_a_reader_that_comes_in_the_middle_of_a_chunk_gets_all_of_it(make: Make) -> None:
    it = make()
    it.chunk.set_readers(0)
    it.send(1, 2)
    it.chunk.set_readers(1)
    it.send(3, 4, start=1000.02)
    assert it.chunk.values == [[1, 2, 3, 4]]


def test_a_reader_of_single_samples_wants_each_at_once(make: Make) -> None:
    it = make()
    assert it.bridge.wants_each_sample
    assert it.bridge.readers == 2
    it.raw.set_readers(0)
    assert not it.bridge.wants_each_sample
    assert it.bridge.readers == 1
    it.raw.set_readers(1)
    it.bridge.settings = replace(ON, raw=False)
    assert not it.bridge.wants_each_sample


def test_the_end_of_a_stream_discards_its_partial_chunk_and_counts_what_lsl_dropped(
    make: Make,
) -> None:
    it = make()
    it.send(1, 2, 3)
    it.bridge.end(7)
    assert (it.counters.discarded, it.counters.undelivered, it.counters.missing) == (3, 7, 7)
    it.send(4, 5, 6, 7, start=1000.03)
    assert it.chunk.values == [[4, 5, 6, 7]]


def test_who_listens_gets_every_sample_whether_or_not_somebody_reads(ros: Ros) -> None:
    header, counters = HEADER, NodeCounters(refusals=Refusals(pytest.fail))
    publisher = RecordedPublisher(Float32, readers=0)
    outputs = Outputs(raw=NumberWriter(publisher, header.message_type, 1, counters.refusals))
    heard: list[list[float]] = []
    bridge = Bridge(
        header,
        outputs,
        ON,
        counters,
        Clocks(ros.node),
        listen=lambda block: heard.extend(block.samples.tolist()),
    )
    assert bridge.wants_each_sample
    bridge.receive(Block(np.array([[1.0], [2.0]], np.float32), np.array([5.0, 5.01])))
    assert heard == [[1.0], [2.0]]
    assert publisher.messages == []


def test_the_newest_sample_of_an_irregular_stream_is_kept(make: Make) -> None:
    it = make(replace(HEADER, rate=0.0, chunk=""))
    assert it.bridge.newest is None
    block = Block(np.array([[1.0], [2.0]], np.float32), np.array([5.0, 6.0]))
    it.bridge.receive(block)
    block.samples[:] = 0
    assert it.bridge.newest is not None
    assert it.bridge.newest.tolist() == [2.0]
    assert it.bridge.last_stamp == 6.0


# Every inlet is read, by whichever thread; no sample is lost or misplaced on a change.


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
