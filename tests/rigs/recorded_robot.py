"""What a recording has of the robot of :mod:`tests.rigs.robot`, as pyxdf loads it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from rclpy.qos import ReliabilityPolicy

from tests.rigs.robot import PARTS

Stream = dict[str, Any]

# LabRecorder does not write what comes in its last half second, and the node may be held up.
UNWRITTEN_S = 2.5
# What comes over these may be lost on the way, to a node that is held up.
BEST_EFFORT = {
    each.topic for each in PARTS if each.quality.reliability is ReliabilityPolicy.BEST_EFFORT
}
# Stream, and the channel that counts its messages.
_COUNTED = {
    "/joint_states": ("joint_states", "panda_joint1.position"),
    "/odom": ("odom", "pose.pose.position.x"),
    "/wrench": ("wrench", "wrench.force.z"),
}
_LOST = re.compile(r"(\S+): (\d+) messages were lost on the way")


def description(stream: Stream, group: str) -> Stream:
    """Return a group of a header's description."""
    return stream["info"]["desc"][0][group][0]


def labels(stream: Stream) -> list[str]:
    """Return one a channel."""
    return [each["label"][0] for each in description(stream, "channels")["channel"]]


def told_lost(log: str) -> Counter[str]:
    """Return by topic how many messages the node's log tells as lost on the way."""
    told = Counter[str]()
    for topic, count in _LOST.findall(log):
        told[topic] += int(count)
    return told


def greatest_errors_s(
    streams: Mapping[str, Stream],
    published: Mapping[str, list[int]],
    span: tuple[int, int],
    offset_s: float,
    lost: Mapping[str, int],
) -> dict[str, float]:
    """Return by topic how far the recorded stamps are off those that were published, at most.

    Every message that was published in the span must be there, once and in order. Of a topic
    that is best effort those may be missing which the node tells as lost.

    Parameters
    ----------
    streams
        By name.
    published
        By topic, as the robot tells it.
    span
        Begin and end, in nanoseconds since 1970.
    offset_s
        Time of day less the recording's.
    lost
        By topic, how many the node tells as lost since its start; see :func:`told_lost`.
    """
    worst_s: dict[str, float] = {}
    for topic, (name, label) in _COUNTED.items():
        stream, sent = streams[name], published[topic]
        column = labels(stream).index(label)
        numbers: list[int] = np.asarray(stream["time_series"])[:, column].astype(int).tolist()
        first, last = (next(n for n, at in enumerate(sent) if at > end) for end in span)
        assert all(one < next_ for one, next_ in pairwise(numbers)), topic
        wanted = range(min(first, numbers[0]), max(last, numbers[-1]) + 1)
        missing = len(wanted) - len(numbers)
        assert missing <= (lost.get(topic, 0) if topic in BEST_EFFORT else 0), (topic, missing)
        sent_s = np.array([sent[number] for number in numbers]) / 1e9
        errors_s = np.asarray(stream["time_stamps"]) + offset_s - sent_s
        worst_s[topic] = float(np.abs(errors_s).max())
    return worst_s
