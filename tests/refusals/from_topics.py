"""Provokes what ``ros_to_lsl`` does not send as it came."""

# Parts stand in for what is around the part that refuses, and some of that is private.
# pyright: reportPrivateUsage=false, reportUnknownLambdaType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from typing import Any

import pytest
from rclpy.qos import QoSProfile

from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.ros_to_lsl import topic_bridge, topic_outlets
from lsl_to_ros.ros_to_lsl.application import RosToLsl
from lsl_to_ros.ros_to_lsl.class_fields import message_class
from lsl_to_ros.ros_to_lsl.graph import Topic
from lsl_to_ros.ros_to_lsl.reports import node_status
from lsl_to_ros.ros_to_lsl.topic_outlets import OtherOutlet
from lsl_to_ros.subscriber_thread import Taker, _Entry
from tests.refusals.provoked import Shown, fake, provokes
from tests.ros_to_lsl.test_bridge import NOW_NS, Outlet, Sent, TFMessage, info, transform

PoseArray, Pose = (message_class(f"geometry_msgs/msg/{each}") for each in ("PoseArray", "Pose"))
PoseStamped = message_class("geometry_msgs/msg/PoseStamped")
STRING = message_class("std_msgs/msg/String")


def sent(patch: pytest.MonkeyPatch, kind: Any, *messages: Any) -> Sent:
    patch.setattr(topic_outlets, "LslOutlet", Outlet)
    topic = Sent("/topic", kind)
    for number, message in enumerate(messages):
        topic.take(message, 10 * number)
    return topic


def entry(topic: Sent) -> Shown:
    status = topic.status()
    return Shown(status.level[0], status.message)


def node(refusals: Refusals) -> Shown:
    status = node_status(1, 1, 0, [], refusals)
    return Shown(status.level[0], status.message)


@provokes(Refusal.NOT_SENT)
def not_sent(patch: pytest.MonkeyPatch) -> Shown:
    image = message_class("sensor_msgs/msg/Image")
    return entry(sent(patch, image, image()))


@provokes(Refusal.NO_NUMBER)
def no_number(patch: pytest.MonkeyPatch) -> Shown:
    return entry(sent(patch, PoseArray, PoseArray()))


@provokes(Refusal.NEW_CHANNELS)
def new_channels(patch: pytest.MonkeyPatch) -> Shown:
    return entry(sent(patch, PoseArray, PoseArray(poses=[Pose()]), PoseArray(poses=[Pose()] * 2)))


@provokes(Refusal.ROUNDED)
def rounded(patch: pytest.MonkeyPatch) -> Shown:
    int64 = message_class("std_msgs/msg/Int64")
    return entry(sent(patch, int64, int64(data=2**60 + 1)))


@provokes(Refusal.TOO_MANY_PAIRS)
def too_many_pairs(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(topic_bridge, "MAX_PAIRS", 1)
    message = TFMessage([transform("odom", "base", 1.0), transform("base", "hand", 2.0)])
    return entry(sent(patch, TFMessage, message))


@provokes(Refusal.DOUBTFUL_STAMPS)
def doubtful_stamps(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped)
    topic.run(PoseStamped, header_s=0.5, source_s=0.0005)
    return entry(topic)


@provokes(Refusal.DOUBTFUL_CLOCK)
def doubtful_clock(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped)
    topic.run(PoseStamped, header_s=0.5, source_s=0.5)
    return entry(topic)


@provokes(Refusal.OTHER_TYPE)
def other_type(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped)
    publishers: Any = [fake(topic_type=f"geometry_msgs/msg/{x}") for x in ("PoseStamped", "Pose")]
    Topic._tell_others(fake(bridge=topic.bridge), publishers, topic.kind.name)
    return entry(topic)


@provokes(Refusal.MIXED)
def mixed(patch: pytest.MonkeyPatch) -> Shown:
    pose = PoseStamped()
    topic = sent(patch, PoseStamped, pose)
    publishers: Any = [
        fake(
            topic_type=topic.kind.name,
            node_namespace="/",
            node_name=name,
            qos_profile=QoSProfile(depth=1),
        )
        for name in ("robot_a", "robot_b")
    ]
    known = fake(
        kind=topic.kind, bridge=topic.bridge, _subscription=None, _tell_others=lambda *_: None
    )
    Topic.follow(known, publishers)
    return entry(topic)


@provokes(Refusal.SENT_TWICE)
def sent_twice(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped, PoseStamped())
    node = fake(get_name=lambda: "ros_to_lsl")
    node.get_subscriptions_info_by_topic = lambda _: [fake(node_name="ros_to_lsl")] * 2
    RosToLsl._tell_sent_twice(
        node, fake(name="/topic", bridge=topic.bridge, is_subscribed=True), ()
    )
    return entry(topic)


@provokes(Refusal.NO_PUBLISHER)
def no_publisher(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped)
    node = fake(_missed_s=0.0, _topics={}, get_service_names_and_types=list)
    known = fake(name="/poses", bridge=topic.bridge)
    RosToLsl._tell_absent(node, fake(topics={"/pose": []}), known, is_absent=True)
    (told,) = topic.bridge.refusals.present
    assert told.sentence == "nothing publishes it yet; is /pose meant?"
    return entry(topic)


@provokes(Refusal.SAME_NAME)
def same_name(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped, PoseStamped())
    node = fake(get_name=lambda: "ros_to_lsl", get_subscriptions_info_by_topic=lambda _: [])
    (name,) = topic.bridge.streams
    others = [OtherOutlet(f"ros-robot-b-0-{name}-12345678", name, "robot-b")]
    RosToLsl._tell_sent_twice(
        node, fake(name="/topic", bridge=topic.bridge, is_subscribed=True), others
    )
    return entry(topic)


@provokes(Refusal.LOST_ON_THE_WAY)
def lost_on_the_way(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, PoseStamped)
    graph = fake(publishers=lambda _: [fake()], is_ours=lambda _: False)
    losses = topic.bridge.losses
    for number in (1, 5):
        losses.take(number)
    known = fake(name="/topic", kind=topic.kind, bridge=topic.bridge, quality="reliable")
    known.follow = lambda publishers: losses.look(len(publishers))
    RosToLsl._follow(fake(_tell_absent=lambda *_, **__: None), graph, known)
    return entry(topic)


@provokes(Refusal.CUT)
def cut(patch: pytest.MonkeyPatch) -> Shown:
    topic = sent(patch, STRING)
    taken = iter([(b"\0\1\0\0\4\0\0\0a\0b\0", info(NOW_NS)), None])
    handle = fake(take_message=lambda _kind, _is_raw: next(taken))
    subscription = fake(handle=handle, msg_type=STRING)
    Taker._take(fake(_failed=lambda *_: None), _Entry(subscription, topic.bridge.take))
    return entry(topic)


@provokes(Refusal.SEND_FAILED)
def send_failed(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    own = fake(_refusals=Refusals())
    RosToLsl._fail(own, fake(topic_name="/topic"), ValueError("no such thing"))
    return node(own._refusals)


@provokes(Refusal.NOT_SMALL)
def not_small(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    own = fake(_refusals=Refusals(), _topics={}, _seen={}, _left_out=[])
    RosToLsl._open_small(own, fake(left_out=lambda: ["/camera"], small=list))
    return node(own._refusals)
