"""What each kind of stream becomes on its stamped topic, of the node that colcon built."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.system.programs import Program
from tests.system.tracks import NS_PER_S, Sample, samples_of, system_minus_lsl_ns
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

# What each kind of stream becomes on its stamped topic, of the node that colcon installed.

SAMPLES = "biosensor_msgs/msg/Samples"
KEPT_SAMPLES = f"{SAMPLES}@latched"
EVENT = "biosensor_msgs/msg/Event"
FLOATS = "std_msgs/msg/Float32MultiArray"
TOLERANCE_NS = 1_000_000
PLACE = DeviceIdentity("zephyr", "BHT012345", participant="p01", label="left")
PLACE_OF_WRIST = DeviceIdentity("empatica_e4", "E4X", participant="p01", label="left")
TEXTS = ["", 'press\n"two"', "µV Δ 皮膚 🫀"]


@pytest.fixture(scope="module", autouse=True)
def node(workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Generator[Program]:
    """One node for all tests of this module, whose streams differ by their names."""
    log = tmp_path_factory.mktemp("node") / "node.log"
    program = Program([workspace.node], log, env=workspace.environment())
    yield program
    ended = program.process.poll()
    program.end()
    assert ended is None, program.output


@pytest.fixture
def listen(workspace: Workspace, start: Callable[..., Program]) -> Callable[..., Listener]:
    """Subscribe: ``listen(TYPE, TOPIC, TYPE, TOPIC)``."""

    def listen(*words: str) -> Listener:
        command = workspace.program("tests.system.listener", *words)
        name = f"listener-{time.monotonic_ns()}"
        return Listener(start(name, command, env=workspace.environment()))

    return listen


def _values(samples: Sequence[Sample]) -> list[str]:
    """Return values as text, in which NaN equals itself and zero is not minus zero."""
    return [repr(sample.values) for sample in samples]


def _texts(samples: Sequence[Sample]) -> list[Any]:
    """Return events as texts, those of several channels as lists of texts."""
    texts = [sample.values[0] for sample in samples]
    return [json.loads(text) if text.startswith("[") else text for text in texts]


def _is_numbered(samples: Sequence[Sample]) -> bool:
    """Whether each sample has the number after that of the one before."""
    numbers = [sample.sequence for sample in samples]
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _errors_ns(samples: Sequence[Sample], stamps: Sequence[float]) -> list[int]:
    """Return the errors of the samples' times, given their LSL stamps."""
    offset_ns = system_minus_lsl_ns()
    return [
        sample.time_ns - round(stamp * NS_PER_S) - offset_ns
        for sample, stamp in zip(samples, stamps, strict=True)
    ]


NUMBERS: dict[str, list[tuple[float, ...]]] = {
    "float32": [(0.5, math.nan), (-0.0, math.inf), (math.nan, -(2.0**-149))],
    "double64": [(0.1, math.nan), (5e-324, -1.7e308), (math.nan, -0.0)],
    "int8": [(-128, 127), (0, -1)],
    "int16": [(-(2**15), 2**15 - 1), (0, -1)],
    "int32": [(-(2**31), 2**31 - 1), (0, -1)],
    "int64": [(2**53 + 1, -(2**53) - 1), (2**63 - 1, -(2**63)), (0, -1)],
}


def test_numbers_of_every_format_are_exact(listen: Callable[..., Listener]) -> None:
    sources = {form: Source(form, "Numbers", form, 2, 100.0) for form in NUMBERS}
    words = [word for source in sources.values() for word in (SAMPLES, source.topic)]
    listener = listen(*words)
    for form, source in sources.items():
        rows = NUMBERS[form]
        listener.wait_until(
            lambda source=source: listener.messages(source.topic), form, source.push_number
        )
        now = pylsl.local_clock()
        stamps = [now + number / 100.0 for number in range(len(rows))]
        source.push(rows, stamps)
        expected = [repr(row if form == "int64" else tuple(map(float, row))) for row in rows]
        listener.wait_until(
            lambda source=source, expected=expected: (
                _values(listener.samples(source.topic))[-len(expected) :] == expected
            ),
            f"{form}: {expected}",
        )
        samples = listener.samples(source.topic)
        assert max(map(abs, _errors_ns(samples[-len(rows) :], stamps))) <= TOLERANCE_NS
        empty = "data" if form == "int64" else "integers"
        assert not any(message[empty] for message in listener.messages(source.topic))


def test_samples_of_an_irregular_stream_keep_their_own_times(
    listen: Callable[..., Listener],
) -> None:
    source = Source("gaze", "Gaze", "float32", 2, 0.0)
    listener = listen(SAMPLES, source.topic)
    listener.wait_until(lambda: listener.messages(source.topic), "gaze", source.push_number)
    now = pylsl.local_clock()
    stamps = [now - age_s for age_s in (1.0, 0.7, 0.6999, 0.2, 0.2, 0.0)]
    rows = [(100.0 + number, math.nan) for number in range(len(stamps))]
    source.push(rows, stamps)
    listener.wait_until(
        lambda: listener.samples(source.topic)[-1].values[0] == rows[-1][0], "the chunk"
    )
    samples = listener.samples(source.topic)
    assert _values(samples[-len(rows) :]) == [repr(row) for row in rows]
    assert max(map(abs, _errors_ns(samples[-len(rows) :], stamps))) <= TOLERANCE_NS
    assert _is_numbered(samples)
    # Nobody can know what is missing from an irregular stream of another program.
    lost = {(each["lost"], each["lost_is_estimated"]) for each in listener.messages(source.topic)}
    assert lost == {(-1, False)}


def test_events_have_their_text_and_time(listen: Callable[..., Listener]) -> None:
    tag = Outlet(declaration("empatica_e4").stream("tag"), PLACE_OF_WRIST, DeviceInfo())
    note = Source("notes", "Markers", "string", 1, 0.0)
    answer = Source("answers", "Markers", "string", 3, 0.0)
    topic = "/p01/biosensors/empatica_e4_left/tag_stamped"
    pushes: dict[str, tuple[str, Callable[[str, float], None]]] = {
        topic: ("p01/empatica_e4_left", tag.push_text),
        note.topic: ("notes", lambda text, stamp: note.push([[text]], [stamp])),
        answer.topic: ("answers", lambda text, stamp: answer.push([[text, "", text]], [stamp])),
    }
    listener = listen(*(word for name in pushes for word in (EVENT, name)))
    for name, (frame_id, push) in pushes.items():
        listener.wait_until(
            lambda name=name: listener.messages(name),
            name,
            lambda push=push: push("waiting", pylsl.local_clock()),
        )
        stamps = [pylsl.local_clock() - age_s for age_s in (0.5, 0.2, 0.0)]
        for text, stamp in zip(TEXTS, stamps, strict=True):
            push(text, stamp)
        expected = [[text, "", text] if name == answer.topic else text for text in TEXTS]
        listener.wait_until(
            lambda name=name, expected=expected: _texts(listener.samples(name))[-3:] == expected,
            f"{name}: {expected}",
        )
        samples = listener.samples(name)
        assert _is_numbered(samples)
        assert max(map(abs, _errors_ns(samples[-len(TEXTS) :], stamps))) <= TOLERANCE_NS
        frames = {message["header"]["frame_id"] for message in listener.messages(name)}
        assert frames == {frame_id}


def test_a_sample_names_its_sensor_with_person_and_place(
    listen: Callable[..., Listener],
) -> None:
    outlet = Outlet(declaration("zephyr").stream("hr"), PLACE, DeviceInfo())
    topic = "/p01/biosensors/zephyr_left/hr_stamped"
    listener = listen(SAMPLES, topic)
    listener.wait_until(
        lambda: listener.messages(topic), topic, lambda: outlet.push([72], [pylsl.local_clock()])
    )
    message = listener.messages(topic)[0]
    assert message["header"]["frame_id"] == "p01/zephyr_left"
    assert (message["labels"], message["units"]) == (["HR"], ["bpm"])
    assert set(message["data"]) == {72.0}


def test_a_gap_is_counted_and_divides_messages(listen: Callable[..., Listener]) -> None:
    rate_hz, missing = 100.0, 200
    source = Source("gaps", "EEG", "float32", 1, rate_hz)
    start_s = pylsl.local_clock() - 30.0
    pushed: list[int] = []

    def push(number: int) -> None:
        pushed.append(number)
        source.push([[number]], [start_s + number / rate_hz])

    listener = listen(SAMPLES, source.topic)
    listener.wait_until(lambda: listener.messages(source.topic), "gaps", lambda: push(len(pushed)))
    after = pushed[-1] + 1 + missing
    # In one piece with those before it, so that a message could span the gap.
    numbers = [pushed[-1] + 1, pushed[-1] + 2, after + 2, after + 3]
    source.push([[n] for n in numbers], [start_s + n / rate_hz for n in numbers])
    listener.wait_until(
        lambda: listener.samples(source.topic)[-1].values[0] == numbers[-1], "what is behind"
    )
    messages = listener.messages(source.topic)
    assert _is_numbered(listener.samples(source.topic))
    assert {message["lost_is_estimated"] for message in messages} == {True}
    (first_behind,) = (each for each in messages if numbers[2] in each["data"])
    assert first_behind["data"][0] == numbers[2]
    before = messages[messages.index(first_behind) - 1]
    assert (before["lost"], messages[-1]["lost"]) == (0, missing)


def test_a_restart_continues_the_numbers_and_loses_nothing_received(
    listen: Callable[..., Listener],
) -> None:
    """Until the new outlet's clock has been measured, its samples wait, and then come once."""
    source = Source("again", "EEG", "float32", 1, 100.0)
    raw_topic = source.topic.removesuffix("_stamped")
    listener = listen(SAMPLES, source.topic, FLOATS, raw_topic)

    def stamped_numbers() -> list[float]:
        return [sample.values[0] for sample in listener.samples(source.topic)]

    def raw_numbers() -> list[float]:
        return [message["data"][0] for message in listener.messages(raw_topic)]

    def has(number: int) -> bool:
        return all(each and each[-1] >= number for each in (stamped_numbers(), raw_numbers()))

    listener.wait_until(lambda: has(0), "the first outlet", source.push_number)
    first = source.pushed
    source.restart()
    listener.wait_until(lambda: has(first), "the second outlet", source.push_number)
    listener.wait_until(lambda last=source.pushed - 1: has(last), "the last sample")

    stamped = stamped_numbers()
    assert [n for n in stamped if n >= first] == [n for n in raw_numbers() if n >= first]
    assert _is_numbered(listener.samples(source.topic))
    # Samples come raw at once, so that they tell what the node had received by then.
    new = [name for name, message in listener.received if message["data"][-1] >= first]
    assert new.index(source.topic) >= 2, "nothing had to wait for the clock"


def test_the_first_samples_of_new_streams_are_there(listen: Callable[..., Listener]) -> None:
    """Whoever subscribed before a stream appeared gets all that the node received of it."""
    known = Source("known", "EEG", "float32", 1, 100.0)
    topics = [f"/biosensors/new{number}/EEG_stamped" for number in range(12)]
    listener = listen(*(word for topic in (known.topic, *topics) for word in (SAMPLES, topic)))
    # From here on the node and the subscriber's process know each other.
    listener.wait_until(lambda: listener.messages(known.topic), "known", known.push_number)
    sources = [Source(topic.split("/")[2], "EEG", "float32", 1, 100.0) for topic in topics]

    def push() -> None:
        for source in sources:
            source.push_number()

    listener.wait_until(
        lambda: {known.topic, *topics} <= {topic for topic, _ in listener.received}, "new", push
    )
    missing = {topic: listener.samples(topic)[0].sequence for topic in topics}
    assert not any(missing.values()), f"received, and not published at first: {missing}"
    assert all(_is_numbered(listener.samples(topic)) for topic in topics)


def test_the_battery_is_kept_for_later_subscribers(listen: Callable[..., Listener]) -> None:
    outlet = Outlet(declaration("zephyr").stream("bat"), PLACE, DeviceInfo())
    topic = "/p01/biosensors/zephyr_left/bat_stamped"
    early = listen(KEPT_SAMPLES, topic)

    def has(percent: float) -> bool:
        return any(sample.values == (percent,) for sample in early.samples(topic))

    stamps: list[float] = []
    for percent in (80.0, 79.0):
        stamps.append(pylsl.local_clock())
        assert outlet.push([percent], stamps[-1:]) is None
        early.wait_until(lambda percent=percent: has(percent), f"{percent} %", outlet.release)
    late = listen(KEPT_SAMPLES, topic)
    late.wait_until(lambda: late.messages(topic), "what was kept")
    (sample,) = late.samples(topic)
    assert sample.values == (79.0,)
    assert abs(_errors_ns([sample], stamps[-1:])[0]) <= TOLERANCE_NS


def test_the_example_shows_how_old_samples_are(
    workspace: Workspace, start: Callable[..., Program]
) -> None:
    person = DeviceIdentity("polar_h10", "virtual", participant="P01")
    outlet = Outlet(declaration("polar_h10").stream("ecg"), person, DeviceInfo())
    example = Path(__file__).parents[2] / "examples" / "ros" / "delay.py"
    program = start("delay", [workspace.python, str(example)], env=workspace.environment())
    deadline = time.monotonic() + DEADLINE_S
    while "samples, newest" not in program.output:
        assert time.monotonic() < deadline, program.output
        assert program.process.poll() is None, program.output
        outlet.push([1.0], [pylsl.local_clock() - 0.5])
        time.sleep(0.01)
    (first, *_) = re.findall(r"newest (\d+) ms old, lost: (\S+)", program.output)
    assert int(first[0]) >= 500
    assert first[1] in {"0", "unknown"}


# Both ends of a stamped topic: a stream of another program, and a subscriber.
DEADLINE_S = 30.0


class Source:
    """A stream of another program; its samples are numbered where nothing else is said."""

    def __init__(self, name: str, content_type: str, form: str, channels: int, rate: float) -> None:
        self._info = pylsl.StreamInfo(
            name, content_type, channels, rate, form, f"test-{name}-{form}"
        )
        self._outlet: pylsl.StreamOutlet | None = None
        self.topic = f"/biosensors/{name}/{content_type}_stamped"
        self.channels = channels
        self.pushed = 0
        self.restart()

    def restart(self) -> None:
        """End the outlet and make another one of the same source_id."""
        self._outlet = None
        self._outlet = pylsl.StreamOutlet(self._info)

    def push(self, rows: Sequence[Sequence[Any]], stamps: Sequence[float]) -> None:
        """Push samples that LSL hands on together."""
        assert self._outlet is not None
        self._outlet.push_chunk([list(row) for row in rows], list(stamps))

    def push_number(self) -> None:
        """Push one sample, measured now, whose values are its number."""
        self.push([[self.pushed] * self.channels], [pylsl.local_clock()])
        self.pushed += 1


class Listener:
    """What a process that subscribes to topics has received."""

    def __init__(self, program: Program) -> None:
        self._program = program

    @property
    def received(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Topics and messages in the order of their arrival."""
        return [(record["topic"], record["message"]) for record in self._program.records]

    def messages(self, topic: str) -> list[Mapping[str, Any]]:
        return [message for name, message in self.received if name == topic]

    def samples(self, topic: str) -> list[Sample]:
        return samples_of(self.messages(topic))

    def wait_until(
        self, condition: Callable[[], object], what: str, meanwhile: Callable[[], object] = int
    ) -> None:
        """Wait for something, doing something else again and again."""
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            said = self._program.output[-2000:]
            assert time.monotonic() < deadline, f"{what} did not come:\n{said}"
            meanwhile()
            time.sleep(0.05)
