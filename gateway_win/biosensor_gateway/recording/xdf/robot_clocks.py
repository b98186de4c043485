"""Judges the clocks of robots whose topics were recorded, by what ``ros_to_lsl`` found out."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.report import Measured

# The fastest messages in a lab's network take no longer: what is later may be the clock.
MAX_EDGE_S = 0.02
_IN_ORDER = ("synchronised", "unknown", "")


class _Told(NamedTuple):
    """What the node said of one clock at one moment."""

    word: str
    edge_s: float

    @property
    def is_doubtful(self) -> bool:
        return self.word not in _IN_ORDER or abs(self.edge_s) >= MAX_EDGE_S


def judge_robot_clocks(streams: Sequence[Measured]) -> Iterator[Finding]:
    """Say which streams of topics have stamps whose clock is not known to be right."""
    heard = {
        each.stream.header.hostname: list(_heartbeats(each.stream.texts))
        for each in streams
        if each.stream.header.is_events_of_node
    }
    for each in streams:
        header = each.stream.header
        robot = header.robot
        if robot is None or header.replay is not None:
            continue
        told = [_Told(robot.clock, robot.edge_s)]
        for topics in heard.get(header.hostname, ()):
            told += _clocks(topics.get(robot.topic))
        doubts = [one for one in told if one.is_doubtful]
        if doubts:
            worst = max(doubts, key=lambda one: 0.0 if math.isnan(one.edge_s) else abs(one.edge_s))
            text = f"{_how_far(worst)}; its first sample has the time of its {robot.stamped_by}"
            yield Finding(Level.WARNING, "robot-clock", header.name, text)


def _how_far(told: _Told) -> str:
    if math.isnan(told.edge_s):
        return "the clock of the robot is not known to be right"
    if told.edge_s < 0:
        return f"the clock of the robot is {-told.edge_s:.3f} s ahead, at least"
    if told.word == "wrong":
        return f"the clock of the robot is wrong: about {told.edge_s:.3f} s behind"
    return f"the clock of the robot may be behind by up to {told.edge_s:.3f} s"


def _heartbeats(texts: Iterable[str]) -> Iterator[Mapping[str, Any]]:
    for text in texts:
        try:
            yield _inside(json.loads(text), "topics")
        except (ValueError, RecursionError):
            continue


def _clocks(topic: object) -> Iterator[_Told]:
    for each in _inside(topic, "clocks").values():
        try:
            yield _Told(str(each["state"]), float(each["edge_s"]))
        except (TypeError, KeyError, ValueError):
            continue


def _inside(content: object, name: str) -> Mapping[str, Any]:
    """Return an object that is inside of another one; an empty one if there is none."""
    inner = cast("Mapping[str, object]", content).get(name) if isinstance(content, dict) else None
    nothing: Mapping[str, Any] = {}
    return cast("Mapping[str, Any]", inner) if isinstance(inner, dict) else nothing
