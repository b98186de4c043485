"""The topic with the headers and clocks of the recording that a bag was exported from.

A bag's messages contain neither the header of a stream nor its clock. The topic is latched. Its
first text, ``recording``, has the start time of the recording and the relation between the
recorder's LSL clock and Unix time. One text per stream, ``stream``, follows: with the header as
recorded, the clock offsets, and the topics with the samples. It is a topic and not metadata,
because programs that cut, join or convert bags keep topics.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.wall_clock import WallClock

TOPIC = "/biosensors/recorded_streams"
# The topics of devices have more than two parts and never begin like this.


@dataclass(frozen=True, slots=True)
class RecordedClock:
    """The start time and the clock of the recording.

    Attributes
    ----------
    begun
        The recorder's text for the start time.
    wall
        Relation between the recorder's LSL clock and Unix time.
    """

    begun: str
    wall: WallClock


@dataclass(frozen=True, slots=True)
class RecordedStream:
    """One stream of the recording.

    Attributes
    ----------
    number
        Number of the stream in the recording.
    stamped
        The topic that has its samples with timestamps.
    topics
        All of its topics.
    xml
        Its header.
    clock_offsets
        Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s.
    """

    number: int
    stamped: str
    topics: tuple[str, ...]
    xml: str
    clock_offsets: tuple[tuple[float, float], ...]


def clock_text(recorded: RecordedClock) -> str:
    """Return the topic's text for a recording."""
    wall = recorded.wall
    pairs = zip(wall.times.tolist(), wall.offsets_ns.tolist(), strict=True)
    clock = [[lsl_s, round(lsl_s * NS_PER_S) + offset_ns] for lsl_s, offset_ns in pairs]
    content = {"begun": recorded.begun, "source": wall.source, "resolution_s": wall.resolution_s}
    return json.dumps({"recording": content | {"clock": clock}})


def stream_text(stream: RecordedStream) -> str:
    """Return the topic's text for a stream."""
    content = {
        "number": stream.number,
        "stamped": stream.stamped,
        "topics": stream.topics,
        "header": stream.xml,
        "clock_offsets": stream.clock_offsets,
    }
    return json.dumps({"stream": content})


def read_text(text: str) -> RecordedClock | RecordedStream:
    """Read one text of the topic.

    Raises
    ------
    ValueError
        If it is invalid.
    """
    try:
        content = json.loads(text)
        if "recording" in content:
            return _clock(content["recording"])
        return _stream(content["stream"])
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("it tells of no recording") from error


def _clock(content: dict[str, Any]) -> RecordedClock:
    pairs = cast("Sequence[tuple[float, int]]", content["clock"])
    times = np.array([float(lsl_s) for lsl_s, _ in pairs])
    offsets_ns = np.array([int(ns) - round(lsl_s * NS_PER_S) for lsl_s, ns in pairs], np.int64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise ValueError("its clock is invalid")
    source, resolution_s = str(content["source"]), float(content["resolution_s"])
    return RecordedClock(str(content["begun"]), WallClock(source, resolution_s, times, offsets_ns))


def _stream(content: dict[str, Any]) -> RecordedStream:
    offsets = tuple((float(at), float(offset)) for at, offset in content["clock_offsets"])
    if not np.isfinite(np.array(offsets)).all():
        raise ValueError("its clock offsets are no numbers")
    return RecordedStream(
        number=int(content["number"]),
        stamped=str(content["stamped"]),
        topics=tuple(map(str, content["topics"])),
        xml=str(content["header"]),
        clock_offsets=offsets,
    )
