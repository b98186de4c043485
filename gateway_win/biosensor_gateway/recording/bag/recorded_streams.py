"""The topic that tells of which recording a bag was made; latched, one text a stream.

A bag's messages have neither the header of a stream nor its clock. The first text, ``recording``,
says when the recording was begun and how the recorder's LSL clock and unix time stood against
each other; each other one, ``stream``, has a stream's header as it was recorded, its clock offsets,
and the topics on which its samples are. A topic it is, and no metadata, because programs that
cut, join or convert bags keep topics.
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
# No device's topic has two parts only, and none of its names begins like this.


@dataclass(frozen=True, slots=True)
class RecordedClock:
    """The recording itself.

    Attributes
    ----------
    begun
        When, by the recorder's own words.
    wall
        Unix time by the recorder's LSL clock.
    """

    begun: str
    wall: WallClock


@dataclass(frozen=True, slots=True)
class RecordedStream:
    """One stream of the recording.

    Attributes
    ----------
    number
        Of the stream, in the recording.
    stamped
        The topic on which its samples have their stamps.
    topics
        All of its topics.
    xml
        Its header.
    clock_offsets
        LSL time on the stream's clock, and what to add to it to get the recorder's, in s.
    """

    number: int
    stamped: str
    topics: tuple[str, ...]
    xml: str
    clock_offsets: tuple[tuple[float, float], ...]


def clock_text(recorded: RecordedClock) -> str:
    """Return the text of a recording."""
    wall = recorded.wall
    pairs = zip(wall.times.tolist(), wall.offsets_ns.tolist(), strict=True)
    clock = [[lsl_s, round(lsl_s * NS_PER_S) + offset_ns] for lsl_s, offset_ns in pairs]
    content = {"begun": recorded.begun, "source": wall.source, "resolution_s": wall.resolution_s}
    return json.dumps({"recording": content | {"clock": clock}})


def stream_text(stream: RecordedStream) -> str:
    """Return the text of a stream."""
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
        If it is something else.
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
        raise ValueError("its clock makes no sense")
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
