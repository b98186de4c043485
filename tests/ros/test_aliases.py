"""Names that a user gives to others' streams, and topics as the original nodes publish them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations
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
from lsl_to_ros.lsl.discovery import SETTLED_S, Discovery
from lsl_to_ros.lsl.inlets import InletState
from lsl_to_ros.parameters.node import ALIASES, aliases_of, fault
from lsl_to_ros.parameters.streams import StreamSettings, check
from lsl_to_ros.routes import renamed
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


class Info:
    """An outlet as the resolver reports it."""

    def __init__(self, uid: str, host: str, started_s: float, kind: int = 3) -> None:
        self._told = {
            "name": "MyMarkerStream",
            "type": "Markers",
            "source_id": "myuidw43536",
            "channel_count": 1,
            "nominal_srate": 0.0,
            "uid": uid,
            "hostname": host,
            "created_at": started_s,
            "channel_format": kind,
        }

    def __getattr__(self, name: str) -> Callable[[], Any]:
        return lambda: self._told[name]


class KnownInlet:
    """An inlet that opens at once, and ends when a test says so."""

    source_id, is_from_ros, is_delivering = "myuidw43536", False, False
    heard_s, waiting, is_served = math.inf, 0, True
    is_foreign = True

    def __init__(self, described: Any, _refusals: Refusals, number: int = 1) -> None:
        self.uid, self.info, self.number = described.uid(), described, number
        self.state = InletState.READY
        self.header = SimpleNamespace(foreign=self.is_foreign)

    def continues_as(self, info: Info) -> bool:
        return info.source_id() == self.source_id

    def matches(self, _predicate: object) -> bool:
        return True

    def stop(self) -> None:
        """Nothing is open."""


class Lab:
    """Outlets that come and go, and a node that looks for them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.present: list[Info] = []
        self.ended: set[str] = set()
        self.said: list[str] = []
        self.now_s = 100.0
        module = "lsl_to_ros.lsl.discovery"

        def resolver(**_options: object) -> SimpleNamespace:
            # One that begins after an outlet's end does not find it.
            ended = frozenset(self.ended)
            return SimpleNamespace(
                results=lambda: [each for each in self.present if each.uid() not in ended]
            )

        monkeypatch.setattr(f"{module}.pylsl.ContinuousResolver", resolver)
        monkeypatch.setattr(f"{module}.Inlet", KnownInlet)
        monkeypatch.setattr(f"{module}.monotonic", lambda: self.now_s)
        self.start()

    def start(self) -> None:
        """Start the node, again."""
        self.discovery = Discovery(self.said.append)

    def look(self, *present: Info, after_s: float = 0.0) -> dict[str, int]:
        """Let the node look; return the numbers of those that it serves."""
        self.now_s += after_s
        self.present[:] = present
        for _ in present:
            self.discovery.update()
            self.now_s += SETTLED_S
        self.discovery.update()
        return {inlet.uid: inlet.number for inlet in self.discovery.inlets}

    def end(self, uid: str) -> None:
        """Let an outlet end; a resolver that knows it still reports it."""
        self.ended.add(uid)
        for inlet in self.discovery.inlets:
            if inlet.uid == uid:
                inlet.state = InletState.LOST


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    yield Lab(monkeypatch)
    KnownInlet.is_foreign = True


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_each_sender_of_another_program_has_a_number_of_its_own(
    lab: Lab, order: tuple[int, ...]
) -> None:
    senders = [Info("c", "lab-pc", 1.0), Info("b", "stim-pc", 2.0), Info("a", "stim-pc", 2.5, 1)]
    assert lab.look(*(senders[place] for place in order)) == {"c": 1, "b": 2, "a": 3}
    first = lab.discovery.inlets[0]
    assert lab.discovery.senders(first) == ["lab-pc", "stim-pc", "stim-pc"]
    assert lab.discovery.twins(first) == []
    # And the same ones if the node starts again.
    lab.start()
    assert lab.look(*senders) == {"c": 1, "b": 2, "a": 3}


def test_a_sender_that_starts_again_gets_its_number_back(lab: Lab) -> None:
    first, second = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
    assert lab.look(first) == {"1": 1}
    assert lab.look(first, second) == {"1": 1, "2": 2}
    lab.end("1")
    # The old outlet is reported for some seconds more, and must not be taken for a third one.
    again = Info("3", "lab-pc", 3.0)
    assert lab.look(first, second, again) == {"2": 2, "3": 1}
    assert lab.look(second, again, after_s=10.0) == {"2": 2, "3": 1}
    lab.end("2")
    assert lab.look(again) == {"3": 1}
    assert lab.discovery.senders(lab.discovery.inlets[0]) == []


def test_one_sender_that_moves_keeps_its_name(lab: Lab) -> None:
    assert lab.look(Info("1", "lab-pc", 1.0)) == {"1": 1}
    lab.end("1")
    assert lab.look(Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)) == {"2": 1}


def test_an_agent_that_starts_again_is_no_second_sender(lab: Lab) -> None:
    KnownInlet.is_foreign = False
    first, second = Info("1", "lab-pc", 1.0), Info("2", "lab-pc", 2.0)
    lab.look(first)
    lab.ended.add("1")
    for _ in range(4):
        # The first one is reported for some seconds more, but does not answer.
        assert lab.look(first, second) == {"2": 1}
    assert lab.discovery.twins(lab.discovery.inlets[0]) == []
    assert lab.said == []


def test_a_second_sender_of_one_device_is_left_out_and_known(lab: Lab) -> None:
    KnownInlet.is_foreign = False
    first, second = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
    lab.look(first)
    assert lab.look(first, second) == {"2": 1}
    (served,) = lab.discovery.inlets
    assert lab.discovery.twins(served) == []
    # It answers a resolver that began after the second one had come.
    assert lab.look(first, second) == {"2": 1}
    assert lab.discovery.twins(served) == ["lab-pc"]
    (told,) = lab.discovery.refusals.present
    assert told.what is Refusal.SAME_SOURCE
    assert len(lab.said) == 1
    lab.look(second)
    assert lab.discovery.twins(served) == []
    assert lab.discovery.refusals.present == []
