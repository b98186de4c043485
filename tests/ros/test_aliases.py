"""Names that a user gives to others' streams, and topics as the original nodes publish them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from biosensor_common.errors import ConfigError
from biosensor_common.lsl.inlet import Block
from biosensor_common.naming import TopicName
from biosensor_common.quantities import ChannelFormat
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from biosensor_gateway.devices.registry import declaration
from lsl_to_ros.parameters.node import ALIASES, aliases_of, check, fault
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.routing import renamed
from lsl_to_ros.statistics.losses import Lost, NodeCounters
from lsl_to_ros.statistics.ros_time import RosTime, Stamping
from lsl_to_ros.topics.bridge import Bridge
from lsl_to_ros.topics.originals import BESIDE, ORIGINALS, Alone, Joined, Shape
from lsl_to_ros.topics.outputs import open_outputs
from lsl_to_ros.topics.writers import StreamContext
from tests.rigs.recorded_topics import RecordedPublisher, header_of

# Names that a user gives to sensors of other programs' streams.

MUSE = "Muse (00:55:DA:B7:1A:2B)"


def foreign(name: str) -> StreamHeader:
    return foreign_header(CoreFields(name, "EEG", "id", "pc", 4, 256.0, ChannelFormat.FLOAT32))


@pytest.mark.parametrize(
    ("given", "name", "sensor"),
    [
        ([f"{MUSE}=muse_left"], MUSE, "muse_left"),
        (["Muse*=muse", "*=other"], MUSE, "muse"),
        (["Muse (00:*=muse", f"{MUSE}=second"], MUSE, "muse"),
        (["*1A:2B) = muse"], MUSE, "muse"),
        (["a=b=c"], "a=b", "c"),
        (["Muse=muse"], MUSE, MUSE),
        (["Muse.*=muse"], MUSE, MUSE),
        ([""], MUSE, MUSE),
    ],
)
def test_the_first_name_that_fits_whole_holds(given: list[str], name: str, sensor: str) -> None:
    header = renamed(foreign(name), name, aliases_of(given))
    assert header.identity.sensor == sensor
    assert replace(header, identity=foreign(name).identity) == foreign(name)


def test_streams_of_agents_keep_their_names() -> None:
    header = replace(foreign(MUSE), foreign=False)
    assert renamed(header, MUSE, {"*": "mine"}) == header


@pytest.mark.parametrize(
    "given", ["muse", "=muse", "Muse=", "Muse=1muse", "Muse=my muse", "Muse=a__b", "Muse=a/b"]
)
def test_what_cannot_be_a_name_is_refused(given: str) -> None:
    assert "UN-2019*=unicorn" in (fault(ALIASES, [given]) or "")


@pytest.mark.parametrize("given", [[], [""], ["Muse=muse"], ["Muse*=muse_2", f"{MUSE}=M"]])
def test_what_can_be_one_is_not(given: list[str]) -> None:
    assert fault(ALIASES, given) is None


# Topics as the original framework's nodes publish them.
NODE: Any = SimpleNamespace(get_clock=lambda: SimpleNamespace(ros_time_is_active=False))
NAN = math.nan


class Topics:
    """The topics of one stream, as clients of the original want them."""

    def __init__(self, sensor: str, data: str, shape: Shape | None = None) -> None:
        self.opened: dict[str, RecordedPublisher] = {}
        header = header_of(sensor, data)
        counters = NodeCounters()
        stamping = Stamping(RosTime(NODE), lambda: 0.0)
        self.refusals = counters.refusals
        context = StreamContext(
            header,
            TopicName(sensor, data),
            sensor,
            stamping,
            lambda: Lost(0, is_estimated=False),
            counters.refusals,
        )
        publishers: Any = SimpleNamespace(open=self._open)
        originals = ORIGINALS[sensor, data]
        shape = shape or Alone(originals[0])
        outputs = open_outputs(publishers, context, (), originals, shape)
        settings = StreamSettings(raw=True, chunk=True, chunk_length=2)
        self.bridge = Bridge(header, outputs, settings, counters, stamping)

    def _open(self, name: str, kind: type[Any], *_: object, **__: object) -> RecordedPublisher:
        self.opened[name] = RecordedPublisher(kind, name)
        return self.opened[name]

    def send(self, samples: Sequence[Sequence[float]], *stamps: float) -> None:
        rate = self.bridge.header.rate or 1.0
        times = stamps or [place / rate for place in range(len(samples))]
        self.bridge.receive(Block(np.array(samples, np.float32), np.array(times)))

    def on(self, name: str) -> list[Any]:
        return self.opened[name].values

    def type_of(self, name: str) -> str:
        return self.opened[name].type_name


EMPATICA, EMOTIV = "empatica_e4", "emotiv_insight"
MET = [0.1, 0.2, 0.3, NAN, 0.5, 0.6, 0.7, 0.8]
CASES = [
    (EMPATICA, "acc", [[1.0, -0.5, 0.015625]], [[64.0, -32.0, 1.0]]),
    (EMPATICA, "bat", [[75.0]], [0.75]),
    (EMPATICA, "gsr", [[0.5], [NAN]], [0.5, 0.0]),
    ("shimmer3_gsr", "gsr", [[2.0], [0.25], [0.0]], [500.0, 4000.0, math.inf]),
    (EMOTIV, "met", [MET], [pytest.approx([0.1, 0.2, 0.3, 0.0, 0.5, 0.6, 0.7])]),
    (EMOTIV, "dev", [[4.0, 2.0, 4, 4, 4, 4, 4, 100.0, NAN]], [[4, 2, 4, 4, 4, 4, 4, 100, -1]]),
]


@pytest.mark.parametrize(("sensor", "data", "samples", "expected"), CASES)
def test_values_are_those_of_the_original(
    sensor: str, data: str, samples: list[list[float]], expected: list[Any]
) -> None:
    topics = Topics(sensor, data)
    topics.send(samples)
    assert topics.on(f"{sensor}/{data}") == expected
    usual = declaration(sensor).stream(data).message_type
    assert topics.type_of(f"{sensor}/{data}") == usual


def test_a_strap_has_whole_numbers_and_the_two_bytes_of_an_interval() -> None:
    topics = Topics("polar_h10", "hr")
    topics.send([[61.0], [250.0]])
    assert topics.on("polar_h10/hr") == [61, 250]
    assert topics.type_of("polar_h10/hr") == "std_msgs/msg/Int32"
    topics = Topics("polar_h10", "ibi")
    ticks = [256, 853, 1024, 0x7FF]
    topics.send([[each / 1024] for each in ticks])
    low, high = topics.on("polar_h10/ibi"), topics.on("polar_h10/dev")
    assert {topics.type_of(f"polar_h10/{each}") for each in ("ibi", "dev")} == {
        "std_msgs/msg/Int32"
    }
    assert [256 * one + other for one, other in zip(high, low, strict=True)] == ticks
    assert max(low) < 256


def test_what_is_no_number_is_no_integer() -> None:
    topics = Topics("polar_h10", "ibi")
    topics.send([[NAN]])
    assert topics.on("polar_h10/ibi") == topics.on("polar_h10/dev") == []
    assert topics.refusals.count(Refusal.UNFIT) == 2


def test_chunks_have_the_same_values() -> None:
    topics = Topics(EMPATICA, "gsr")
    topics.send([[0.5], [NAN], [1.0], [2.0]])
    assert topics.on(f"{EMPATICA}/gsr_chunk") == [[0.5, 0.0], [1.0, 2.0]]


def headset() -> tuple[Joined, Topics]:
    joined = Joined(ORIGINALS[EMOTIV, "eeg"][0])
    joined.refusals = Refusals()
    topics = Topics(EMOTIV, "eeg", joined)
    joined.more = topics.bridge.more
    return joined, topics


def eeg(number: float) -> list[float]:
    return [number + electrode / 10 for electrode in range(1, 6)]


def status(joined: Joined, *stamps: float) -> None:
    rows = [[round(128 * stamp), 0.0, 1000.0, 0.0] for stamp in stamps]
    joined.take(Block(np.array(rows, np.float32), np.array(stamps)))


def eight(number: int, counter: float) -> Any:
    return pytest.approx([counter, 0.0, *eeg(number), 1000.0])


def test_a_headset_has_its_eight_columns_whichever_part_comes_first() -> None:
    joined, topics = headset()
    stamps = [place / 128 for place in range(5)]
    status(joined, *stamps[:2])
    topics.send([eeg(0), eeg(1), eeg(2)], *stamps[:3])
    assert topics.on(f"{EMOTIV}/eeg") == [eight(0, 0), eight(1, 1)]
    status(joined, stamps[2])
    assert topics.on(f"{EMOTIV}/eeg") == [eight(at, at) for at in range(3)]
    topics.send([eeg(3), eeg(4)], *stamps[3:])
    status(joined, *stamps[3:])
    assert topics.on(f"{EMOTIV}/eeg") == [eight(at, at) for at in range(5)]
    flat = [value for row in topics.on(f"{EMOTIV}/eeg")[:4] for value in row]
    assert [value for chunk in topics.on(f"{EMOTIV}/eeg_chunk") for value in chunk] == flat
    assert joined.refusals is not None
    assert joined.refusals.all == []


def test_what_the_other_part_does_not_bring_is_said_to_be_missing() -> None:
    joined, topics = headset()
    stamps = [place / 128 for place in range(3)]
    status(joined, stamps[0], stamps[2])
    topics.send([eeg(0), eeg(1), eeg(2)], *stamps)
    first, second, third = topics.on(f"{EMOTIV}/eeg")
    assert (first, third) == (eight(0, 0), eight(2, 2))
    assert second[2:7] == pytest.approx(eeg(1))
    assert [math.isnan(value) for value in second] == [True, True, *[False] * 5, True]
    assert joined.refusals is not None
    (told,) = joined.refusals.all
    assert told.what is Refusal.NOT_JOINED
    assert "1 sample was published without counter and contact quality" in told.sentence


def test_nothing_is_waited_for_for_ever() -> None:
    joined, topics = headset()
    stamps = [place / 128 for place in range(300)]
    topics.send([eeg(0)] * 300, *stamps)
    assert len(topics.on(f"{EMOTIV}/eeg")) == 300 - 256
    assert joined.refusals is not None
    assert joined.refusals.count(Refusal.NOT_JOINED) == 300 - 256


def test_each_of_them_is_a_stream_of_a_sensor() -> None:
    for sensor, data in [*ORIGINALS, *BESIDE]:
        assert declaration(sensor).stream(data).data_name == data
    for (sensor, data), originals in ORIGINALS.items():
        assert originals[0].data == data
        if originals[0].beside:
            channels = declaration(sensor).stream(originals[0].beside).channels
            assert len(channels) == originals[0].beside_channels


def test_the_form_of_all_topics_is_not_left_to_chance() -> None:
    check({"compat": "smartlab"})
    check({"compat": ""})
    for given, words in (
        ({"compat": "smart"}, "must be smartlab or empty"),
        ({"compt": "smartlab"}, "compat is"),
    ):
        with pytest.raises(ConfigError, match=words):
            check(given)
