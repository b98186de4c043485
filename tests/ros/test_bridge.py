"""What a bridge publishes, drops and counts of the samples that it is given."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from builtin_interfaces.msg import Time

from biosensor_common.quantities import Category, ChannelFormat, MessageType
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.bridge import FOREIGN_JITTER_S, Bridge, Tally
from lsl_to_ros.losses import LossAccount
from lsl_to_ros.parameters import StreamSettings

HEADER = StreamHeader(
    identity=DeviceIdentity("zephyr", "BH1"),
    data_name="ecg",
    category=Category.RAW,
    content_type="ECG",
    labels=("ECG",),
    units=("counts",),
    rate=100.0,
    format=ChannelFormat.FLOAT32,
    message_type=MessageType.FLOAT32,
    chunk="ecg",
)
ON = StreamSettings(raw=True, chunk=True, chunk_length=4)


@dataclass
class Topic:
    """Stands for a publisher."""

    topic_name: str = "/topic"
    readers: int = 1
    sent: list[Any] = field(default_factory=list[Any])

    def publish(self, msg: Any) -> None:
        self.sent.append(msg.data)

    def get_subscription_count(self) -> int:
        return self.readers


@dataclass
class Setup:
    bridge: Bridge
    raw: Topic
    chunk: Topic
    tally: Tally
    warnings: list[str]

    def send(self, *values: float, start: float = 1000.0, step: float = 0.01) -> None:
        for number, value in enumerate(values):
            self.bridge.receive([value], start + number * step)


Make = Callable[..., Setup]


@pytest.fixture
def make() -> Make:
    def setup(header: StreamHeader = HEADER, settings: StreamSettings = ON) -> Setup:
        raw, chunk, tally = Topic(), Topic(), Tally()
        warnings: list[str] = []
        bridge = Bridge(
            header,
            raw,
            chunk if header.chunk else None,
            settings,
            LossAccount(),
            tally,
            lambda _: Time(),
            warnings.append,
        )
        return Setup(bridge, raw, chunk, tally, warnings)

    return setup


def test_every_sample_goes_out_at_once_and_in_its_chunk(make: Make) -> None:
    it = make()
    it.send(1, 2, 3, 4, 5)
    assert it.raw.sent == [1, 2, 3, 4, 5]
    assert [list(chunk) for chunk in it.chunk.sent] == [[1, 2, 3, 4]]
    assert it.tally == Tally(received=5)


def test_a_chunk_never_spans_a_gap(make: Make) -> None:
    it = make()
    it.send(1, 2, 3)
    it.send(4, 5, 6, 7, start=1000.02 + 0.1)
    assert it.raw.sent == [1, 2, 3, 4, 5, 6, 7]
    assert [list(chunk) for chunk in it.chunk.sent] == [[4, 5, 6, 7]]
    assert (it.tally.discarded, it.tally.missing) == (3, 9)


def test_a_stamp_that_is_a_little_late_is_no_gap(make: Make) -> None:
    it = make()
    it.send(1, 2, 3, 4, step=0.0149)
    assert len(it.chunk.sent) == 1
    assert it.tally == Tally(received=4)


def test_stamps_of_other_programs_may_jitter(make: Make) -> None:
    it = make(replace(HEADER, foreign=True))
    it.send(1, 2, 3, 4, step=FOREIGN_JITTER_S * 0.9)
    assert len(it.chunk.sent) == 1
    it.send(5, 6, step=FOREIGN_JITTER_S * 2.0, start=1001.0)
    assert it.tally.missing > 0


def test_an_irregular_stream_has_no_gaps(make: Make) -> None:
    it = make(replace(HEADER, rate=0.0, chunk=""))
    it.send(1, 2, 3, step=60.0)
    assert it.raw.sent == [1, 2, 3]
    assert it.tally == Tally(received=3)


@pytest.mark.parametrize("stamp", [math.inf, -math.inf, math.nan, 1e308, 0.0, -5.0])
def test_no_stamp_stops_a_stream(make: Make, stamp: float) -> None:
    it = make(replace(HEADER, rate=1e300))
    it.send(1)
    it.bridge.receive([2.0], stamp)
    it.send(3, start=1000.01)
    assert it.raw.sent == [1, 2, 3]
    assert it.tally.received == 3


def test_a_sample_that_does_not_fit_is_counted_and_said_once(make: Make) -> None:
    it = make(replace(HEADER, message_type=MessageType.UINT8, format=ChannelFormat.INT16))
    it.send(60, 300, -1, 61)
    assert it.raw.sent == [60, 61]
    assert it.tally.unfit == 2
    assert len(it.warnings) == 1
    assert "zephyr ecg" in it.warnings[0]
    assert "300" in it.warnings[0]


def test_a_chunk_does_not_go_on_after_a_sample_that_does_not_fit(make: Make) -> None:
    header = replace(HEADER, message_type=MessageType.INT32_MULTI_ARRAY)
    it = make(header)
    it.raw.readers = 0
    it.send(1, 2, 2**40, 3, 4, 5, 6)
    assert [list(chunk) for chunk in it.chunk.sent] == [[3, 4, 5, 6]]
    assert it.tally == Tally(received=7, unfit=1, discarded=2)


def test_the_raw_topic_alone_can_be_silenced(make: Make) -> None:
    it = make(settings=replace(ON, raw=False))
    it.send(1, 2, 3, 4)
    assert it.raw.sent == []
    assert len(it.chunk.sent) == 1


def test_silenced_chunks_leave_nothing_behind(make: Make) -> None:
    it = make()
    it.send(1, 2)
    it.bridge.settings = replace(ON, chunk=False)
    it.send(3, 4, start=1000.02)
    it.bridge.settings = ON
    it.send(5, 6, 7, 8, start=1000.04)
    assert it.raw.sent == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [list(chunk) for chunk in it.chunk.sent] == [[5, 6, 7, 8]]
    assert it.tally.discarded == 2


def test_what_nobody_reads_is_not_published_but_counted(make: Make) -> None:
    it = make()
    it.raw.readers = it.chunk.readers = 0
    it.send(1, 2, 3, 4)
    assert it.raw.sent == it.chunk.sent == []
    assert it.tally.received == 4


def test_a_reader_of_the_raw_topic_wants_each_sample(make: Make) -> None:
    it = make()
    assert it.bridge.wants_each_sample
    it.raw.readers = 0
    assert not it.bridge.wants_each_sample
    it.raw.readers = 1
    it.bridge.settings = replace(ON, raw=False)
    assert not it.bridge.wants_each_sample


def test_the_end_of_a_stream_discards_its_partial_chunk(make: Make) -> None:
    it = make()
    it.send(1, 2, 3)
    it.bridge.end()
    assert it.tally.discarded == 3
