"""Provokes what ``lsl_to_ros`` does not publish as it came."""

# Parts stand in for what is around the part that refuses, and some of that is private.
# pyright: reportPrivateUsage=false, reportUnknownLambdaType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pylsl
import pytest
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float32, Float32MultiArray, UInt8

from biosensor_common import process_limits
from biosensor_common.lsl.inlet import Block
from biosensor_common.naming import resolve_topics
from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import CoreFields, foreign_header
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.lsl.discovery import Discovery, FileRoom
from lsl_to_ros.lsl.inlets import Inlet, InletState, header_of
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.reports import reporter
from lsl_to_ros.reports.diagnostics import LEASE_S, judge
from lsl_to_ros.reports.reporter import Reporting, Survey
from lsl_to_ros.routes import Routing
from lsl_to_ros.statistics.losses import Delays, Lost, NodeCounters
from lsl_to_ros.statistics.ros_time import RosTime, Stamping
from lsl_to_ros.topics.bridge import Bridge, Outputs
from lsl_to_ros.topics.lanes import Lane, Pace, Pacer
from lsl_to_ros.topics.originals import ORIGINALS, Joined
from lsl_to_ros.topics.outputs import open_outputs
from lsl_to_ros.topics.publishers import TopicTypeError
from lsl_to_ros.topics.writers import (
    ChunkWriter,
    NumberWriter,
    Run,
    StandardMessageWriter,
    StreamContext,
)
from tests.refusals.provoked import Shown, at_node, fake, in_entry, provokes
from tests.rigs.recorded_topics import RecordedPublisher
from tests.rigs.recorded_topics import header_of as declared
from tests.ros.test_aliases import Info, KnownInlet, Lab
from tests.ros.test_judging import facts

ON = StreamSettings(raw=True, chunk=True, chunk_length=4)
NODE: Any = fake(get_clock=lambda: fake(ros_time_is_active=False, now=lambda: None))
KIND = MessageType.FLOAT32_MULTI_ARRAY


def bridge(kind: MessageType = MessageType.FLOAT32, *, is_known: bool = True) -> Bridge:
    """Return the bridge of a stream with a raw topic, one with stamps, and chunks."""
    header = replace(declared("zephyr", "st"), rate=100.0, chunk="st", message_type=kind)
    counters = NodeCounters()
    stamping = Stamping(RosTime(NODE), lambda: 0.0 if is_known else None)
    published = {MessageType.UINT8: UInt8}.get(kind, Float32)
    raw = NumberWriter(RecordedPublisher(published), kind, 1, counters.refusals)
    (temperature,) = standard_messages(declared("zephyr", "st"), "zephyr")
    timed = StandardMessageWriter(RecordedPublisher(Temperature), temperature, stamping)
    chunk = ChunkWriter(RecordedPublisher(Float32MultiArray), KIND, 1)
    return Bridge(header, Outputs(raw, [timed], chunk), ON, counters, stamping)


def send(to: Bridge, *stamps: float, value: float = 1.0) -> Bridge:
    to.receive(Block(np.full((len(stamps), 1), value, np.float32), np.array(stamps)))
    return to


def now() -> float:
    return pylsl.local_clock()


@provokes(Refusal.UNFIT)
def unfit(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return in_entry(send(bridge(MessageType.UINT8), now(), value=300.0))


@provokes(Refusal.NO_TIME)
def no_time(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return in_entry(send(bridge(), now(), 1e300, now()))


@provokes(Refusal.NOT_JOINED)
def not_joined(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    (((_, data), (original,)),) = [each for each in ORIGINALS.items() if each[1][0].beside]
    half = bridge(KIND)
    joined = Joined(original)
    joined.refusals = half.counters.refusals
    stamps, others = np.array([0.0, 0.01]), np.array([0.01, 0.02])
    joined.take(Block(np.zeros((2, original.beside_channels), np.float32), others))
    assert len(joined(Run(np.zeros((2, 5), np.float32), stamps, 0)).samples) == 2, data
    return in_entry(send(half, now()))


@provokes(Refusal.UNSTAMPED)
def unstamped(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    ended = send(bridge(is_known=False), now())
    ended.end(0)
    return in_entry(ended)


@provokes(Refusal.CHUNK_CUT)
def chunk_cut(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return in_entry(send(bridge(), now() - 5.0, now()))


@provokes(Refusal.UNDELIVERED)
def undelivered(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    ended = send(bridge(), now())
    ended.end(7)
    return in_entry(ended)


@provokes(Refusal.UNIX_STAMPS)
def unix_stamps(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return in_entry(send(bridge(), time.time()))


def judged(**told: Any) -> Shown:
    level, text = judge(facts(**told))
    return Shown(level[0], text)


@provokes(Refusal.FOREIGN_STAMPS)
def foreign_stamps(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    delays = Delays()
    delays.add(4000.0)
    return judged(delays=delays)


@provokes(Refusal.UNKNOWN_CLOCK)
def unknown_clock(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return judged(correction_s=None, attached_s=60.0)


@provokes(Refusal.DOUBLED)
def doubled(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return judged(doubled_s=LEASE_S + 1)


@provokes(Refusal.MAYBE_DOUBLED)
def maybe_doubled(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    return judged(doubled_s=1.0)


@provokes(Refusal.TWO_UNITS)
def two_units(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    units = {unit: (DeviceIdentity("zephyr", unit), "ecg") for unit in ("U1", "U2")}
    return judged(topic=resolve_topics(units)["U1"])


@provokes(Refusal.TWO_STREAMS)
def two_streams(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    streams = dict.fromkeys(("a", "b"), (DeviceIdentity("zephyr", "U1"), "ecg"))
    return judged(topic=resolve_topics(streams)["a"])


@provokes(Refusal.SECOND_SENDER)
def second_sender(patch: pytest.MonkeyPatch) -> Shown:
    lab = Lab(patch)
    lab.look(Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0))
    return judged(senders=lab.discovery.senders(lab.discovery.inlets[0]))


@provokes(Refusal.SAME_SOURCE)
def same_source(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(KnownInlet, "is_foreign", False)
    lab = Lab(patch)
    for _ in range(2):
        lab.look(Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0))
    return judged(twins=lab.discovery.twins(lab.discovery.inlets[0]))


@provokes(Refusal.UNUSABLE)
def unusable(patch: pytest.MonkeyPatch) -> Shown:
    info = pylsl.StreamInfo("no channels", "EEG", 0, 0.0, "float32", "zero")
    resolver = fake(results=lambda: [info])
    patch.setattr("lsl_to_ros.lsl.discovery.pylsl.ContinuousResolver", lambda **_: resolver)
    discovery = Discovery(lambda _: None)
    discovery.update()
    assert not discovery.inlets
    return at_node(discovery.refusals)


@provokes(Refusal.NO_FILES)
def no_files(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(process_limits, "has_room", lambda _: False)
    refusals = Refusals()
    room = FileRoom(refusals)
    assert not room.has_room(pylsl.StreamInfo("crowd", "EEG", 1, 1.0, "float32", "c"), 0)
    (told,) = refusals.present
    shown = at_node(refusals, crowded_out=room.crowded_out)
    # It is named together with others, by the same reason.
    assert process_limits.no_room() in told.sentence
    text = shown.text.replace("1 streams are left out (crowd)", "it is left out")
    return shown._replace(text=text)


@provokes(Refusal.NO_DESCRIPTION)
def no_description(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    core = CoreFields("lying", "EEG", "id", "lab-pc", 1, 100.0, ChannelFormat.FLOAT32)
    refusals = Refusals()
    info: Any = fake(name=lambda: "lying", hostname=lambda: "lab-pc", as_xml=lambda: "<info")
    assert header_of(info, core, refusals) == foreign_header(core)
    return at_node(refusals)


@provokes(Refusal.READ_FAILED)
def read_failed(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    inlet = Inlet.__new__(Inlet)
    inlet.state, inlet._refusals = InletState.READY, Refusals()
    inlet.info = pylsl.StreamInfo("broken", "EEG", 1, 1.0, "float32", "b")
    inlet._reading = fake(lsl=fake(flush=lambda: 3))
    inlet._delivery = fake(end=lambda _: None)
    inlet._is_stopped = fake(is_set=lambda: False)

    def fails(_reading: object) -> None:
        raise ValueError("no such thing")

    inlet._guarded(fails)
    return at_node(inlet._refusals)


@provokes(Refusal.UNSENT)
def unsent(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    clock = [0.0]

    def fails(_message: object) -> None:
        raise RuntimeError("no such thing")

    pacer = Pacer(Pace(1.0), lambda _: None, lambda: clock[0])
    lane = Lane(fails, lambda: True, pacer, rate=1.0, piece=10, topic="/ecg")
    lane._messages.append((0.0, b""))
    clock[0] = 10.0
    pacer.wake(lane)
    pacer.turn()
    return at_node(pacer.refusals)


def routing(create_publisher: Callable[..., Any]) -> Routing:
    settings = fake(declare=lambda *_: None, settings=lambda *_: ON)
    log: Any = LimitedLog(fake(warning=lambda _: None, info=lambda _: None))
    node: Any = fake(
        create_publisher=create_publisher,
        destroy_publisher=lambda _: None,
        resolve_topic_name=lambda topic: topic,
        has_parameter=lambda _: False,
    )
    pacer = Pacer(Pace(), lambda _: None)
    return Routing(node, "biosensors", settings, RosTime(NODE), log, pacer)


def inlet_of(uid: str, rate: float = 100.0) -> Any:
    core = CoreFields("amp", "EEG", "amp-1", "lab-pc", 1, rate, ChannelFormat.FLOAT32)
    return fake(
        uid=uid,
        core=core,
        header=foreign_header(core),
        is_served=True,
        source_id="amp-1",
        correction=0.0,
        is_delivering=False,
    )


@provokes(Refusal.NO_TOPIC)
def no_topic(patch: pytest.MonkeyPatch) -> Shown:
    del patch

    def refuses(*_: object, **__: object) -> None:
        raise ValueError("no such name")

    routes = routing(refuses)
    routes.update([inlet_of("1")], [])
    return at_node(routes.refusals)


@provokes(Refusal.FORMAT_CHANGED)
def format_changed(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    handle = fake(publish_raw=lambda _: None)
    routes = routing(lambda _kind, topic, *_, **__: fake(topic_name=topic, handle=handle))
    first, second = inlet_of("1"), inlet_of("2", 250.0)
    routes.update([first], [])
    routes.update([second], [first])
    (route,) = routes.routes
    assert route.bridge is not None
    return in_entry(send(route.bridge, now()))


@provokes(Refusal.NO_COUNTS)
def no_counts(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    routes = routing(lambda *_, **__: None)
    routes._take_report(np.array(["nonsense"], object))
    return at_node(routes.refusals)


@provokes(Refusal.NO_STANDARD_TOPIC)
def no_standard_topic(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    made = bridge()
    header, refusals = declared("zephyr", "st"), made.counters.refusals

    def opened(topic: str, kind: type[Any], *_: object, **__: object) -> Any:
        if kind.__name__ == "Temperature":
            raise TopicTypeError("in use")
        return RecordedPublisher(kind, topic)

    (topic,) = resolve_topics({"a": (header.identity, "st")}).values()
    stamping = Stamping(RosTime(NODE), lambda: 0.0)
    lost = Lost(0, is_estimated=False)
    context = StreamContext(header, topic, "zephyr", stamping, lambda: lost, refusals)
    open_outputs(fake(open=opened), context)
    return in_entry(send(made, now()))


def concerns(
    patch: pytest.MonkeyPatch,
    what: Refusal,
    publishers: int = 1,
    after_s: float = 0.0,
    *,
    is_simulated: bool = False,
    has_stamped: bool = True,
) -> Shown:
    clock = [0.0]
    patch.setattr(reporter, "monotonic", lambda: clock[0])
    patch.setattr(reporter, "HAS_STAMPED_TOPICS", has_stamped)
    patch.setattr(reporter, "make_publisher", lambda *_, **__: fake(publish=None, topic_name="~"))
    patch.setattr(Reporting, "list_streams", lambda *_: None)
    node: Any = fake(
        get_clock=lambda: None,
        count_publishers=lambda _: publishers,
        get_parameter_or=lambda _: fake(value=is_simulated),
    )
    reports = Reporting(node, RosTime(NODE), lambda _: None)
    clock[0] = after_s
    (concern,) = reports._concerns()
    assert concern.level == what.level
    return Shown(concern.level, concern.text)


@provokes(Refusal.READ_IN_VAIN)
def read_in_vain(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    read = send(bridge(), now())
    told = {"node_namespace": "/", "topic_type": "std_msgs/msg/Int32"}
    reader = fake(node_name="client", **told)
    node: Any = fake(
        count_subscribers=lambda _: 2, get_subscriptions_info_by_topic=lambda _: [reader]
    )
    other: Any = None
    Survey(node, other, other, other, pytest.fail)._look_at_readers(read)
    return in_entry(read)


@provokes(Refusal.NODE_TWICE)
def node_twice(patch: pytest.MonkeyPatch) -> Shown:
    return concerns(patch, Refusal.NODE_TWICE, 2, LEASE_S + 1)


@provokes(Refusal.NODE_MAYBE_TWICE)
def node_maybe_twice(patch: pytest.MonkeyPatch) -> Shown:
    return concerns(patch, Refusal.NODE_MAYBE_TWICE, 2, 1.0)


@provokes(Refusal.SIMULATED_TIME)
def simulated_time(patch: pytest.MonkeyPatch) -> Shown:
    return concerns(patch, Refusal.SIMULATED_TIME, is_simulated=True)


@provokes(Refusal.NO_STAMPED_TOPICS)
def no_stamped_topics(patch: pytest.MonkeyPatch) -> Shown:
    return concerns(patch, Refusal.NO_STAMPED_TOPICS, has_stamped=False)
