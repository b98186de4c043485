"""What a recording has of the robot of :mod:`tests.rigs.robot`, as pyxdf loads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

Stream = dict[str, Any]

# LabRecorder does not write what comes in its last half second.
UNWRITTEN_S = 1.0
# Stream, and the channel that counts its messages.
_COUNTED = {
    "/joint_states": ("joint_states", "panda_joint1.position"),
    "/odom": ("odom", "pose.pose.position.x"),
    "/wrench": ("wrench", "wrench.force.z"),
}


def description(stream: Stream, group: str) -> Stream:
    """Return a group of a header's description."""
    return stream["info"]["desc"][0][group][0]


def labels(stream: Stream) -> list[str]:
    """Return one a channel."""
    return [each["label"][0] for each in description(stream, "channels")["channel"]]


def greatest_errors_s(
    streams: Mapping[str, Stream],
    published: Mapping[str, list[int]],
    span: tuple[int, int],
    offset_s: float,
) -> dict[str, float]:
    """Return by topic how far the recorded stamps are off those that were published, at most.

    Every message that was published in the span must be there, once.

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
    """
    worst_s: dict[str, float] = {}
    for topic, (name, label) in _COUNTED.items():
        stream, sent = streams[name], published[topic]
        column = labels(stream).index(label)
        numbers: list[int] = np.asarray(stream["time_series"])[:, column].astype(int).tolist()
        first, last = (next(n for n, at in enumerate(sent) if at > end) for end in span)
        assert numbers == list(range(numbers[0], numbers[-1] + 1)), topic
        assert numbers[0] <= first, topic
        assert numbers[-1] >= last, topic
        sent_s = np.array([sent[number] for number in numbers]) / 1e9
        errors_s = np.asarray(stream["time_stamps"]) + offset_s - sent_s
        worst_s[topic] = float(np.abs(errors_s).max())
    return worst_s
