"""Makes outlets for topics; their headers describe the origin of the samples.

In addition to XDF's fields a header has one block, by which ``lsl_to_ros`` recognises streams
that it must not publish again::

    <ros>
      <topic>/joint_states</topic> <type>sensor_msgs/msg/JointState</type>
      <type_hash>RIHS01_...</type_hash> <frame_id>base</frame_id>
      <stamp_source>header</stamp_source> <clock>synchronised</clock>
      <clock_edge_s>0.000180</clock_edge_s>
    </ros>
"""

from __future__ import annotations

import math
import os
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

import pylsl

from biosensor_common import naming
from biosensor_common.lsl.network import Network
from biosensor_common.lsl.outlet import LslOutlet
from biosensor_common.lsl.predicates import begins_with
from biosensor_common.lsl_header import append_children
from biosensor_common.quantities import ChannelFormat, ContentType
from biosensor_common.ros.layout import Channel
from lsl_to_ros.ros_to_lsl.stamps import ClockState, StampSource

_PREFIX = "ros-"
READY = "ros_to_lsl ready"
"""A marker sent when the first receiver connects. Some versions of the MATLAB loader cannot load a
stream without markers."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of the samples of a stream."""

    topic: str
    # type_name, type_hash: name and hash of the message type; empty before anybody publishes.
    type_name: str = ""
    type_hash: str = ""
    # `frame_id` and `child_frame_id` of the first message, if it has them.
    frames: Mapping[str, str] | None = None
    # Source of the first message's stamp, or the expected one.
    stamp_source: StampSource = StampSource.SOURCE
    clock: ClockState = ClockState.UNKNOWN
    # Its lower edge of arrival minus stamp; None before a message has come.
    clock_edge_s: float | None = None


def sample_info(
    name: str, origin: Origin, channels: Sequence[Channel], rate: float
) -> pylsl.StreamInfo:
    """Return the StreamInfo of a numeric stream with the channels of a layout."""
    shape = sha256("\n".join(each.label for each in channels).encode()).hexdigest()[:8]
    info = pylsl.StreamInfo(
        name,
        _content_type(origin, channels),
        len(channels),
        rate,
        ChannelFormat.DOUBLE64.value,
        f"{_source_id(name)}-{shape}",
    )
    description = Element("desc")
    above = SubElement(description, "channels")
    for each in channels:
        node = SubElement(above, "channel")
        _fill(node, label=each.label, unit=each.unit, type=each.kind)
        values = SubElement(node, "values") if each.values else node
        for number, text in each.values.items():
            _fill(SubElement(values, "value"), number=str(number), name=text)
    _describe(description, origin, can_drop_samples=rate > 0)
    append_children(info.desc(), description)
    return info


class SampleOutlet:
    """An outlet of numbers, with the channels of a layout."""

    def __init__(self, name: str, origin: Origin, channels: Sequence[Channel], rate: float) -> None:
        self._outlet = LslOutlet(info := sample_info(name, origin, channels, rate))
        self.source_id = info.source_id()
        _note_own(self._outlet)
        self.pushed = 0

    def push(self, values: Sequence[float], stamp: float) -> None:
        """Push one sample."""
        self._outlet.push_sample(values, stamp)
        self.pushed += 1

    def have_consumers(self) -> bool:
        """Whether anybody receives the stream."""
        return self._outlet.have_consumers()


class MarkerOutlet:
    """An outlet of text markers.

    Attributes
    ----------
    is_state
        Whether the newest marker still holds, so that the first receiver gets it, too.
    """

    def __init__(self, name: str, origin: Origin) -> None:
        info = pylsl.StreamInfo(
            name,
            ContentType.MARKERS.value,
            1,
            0.0,
            ChannelFormat.STRING.value,
            _source_id(name),
        )
        description = Element("desc")
        node = SubElement(SubElement(description, "channels"), "channel")
        _fill(node, label="marker", unit="none", type=ContentType.MARKERS.value)
        _describe(description, origin, can_drop_samples=False)
        append_children(info.desc(), description)
        self._outlet = LslOutlet(info)
        self.source_id = info.source_id()
        _note_own(self._outlet)
        self._had_consumers = self.is_state = False
        self._newest: str | None = None
        self.pushed = 0

    def push(self, text: str, stamp: float) -> None:
        """Push one marker."""
        # A receiver of this marker needs no start marker.
        self._had_consumers = self.have_consumers()
        self._outlet.push_sample([text], stamp)
        self._newest = text
        self.pushed += 1

    def look(self, stamp: float) -> None:
        """Send the start marker, with an LSL time, if the first receiver has connected."""
        had_consumers, self._had_consumers = self._had_consumers, self.have_consumers()
        if self._had_consumers and not had_consumers:
            self._outlet.push_sample([READY], stamp)
            if self.is_state and self._newest is not None:
                self.push(self._newest, stamp)

    def have_consumers(self) -> bool:
        """Whether anybody receives the stream."""
        return self._outlet.have_consumers()


# Of all outlets of this process, also of those that have ended and may still be found.
_own_uids: set[str] = set()


def _note_own(outlet: LslOutlet) -> None:
    _own_uids.add(outlet.get_info().uid())


class OtherOutlet(NamedTuple):
    """An outlet of another process of this program."""

    source_id: str
    name: str
    host: str


class OtherOutlets:
    """Finds outlets of other processes of this program.

    Their nodes may have other names, may be on other robots, and may send a different topic of the
    same name.
    """

    def __init__(self) -> None:
        self._network = Network(begins_with("source_id", _PREFIX))

    def look(self) -> list[OtherOutlet]:
        """Return the present outlets."""
        return [
            OtherOutlet(each.source_id(), each.name(), each.hostname())
            for each in self._network.streams()
            if each.uid() not in _own_uids
        ]


def with_stamp(origin: Origin, source: StampSource, clock: ClockState, edge_s: float) -> Origin:
    """Return an origin with the source and clock of the stamps."""
    edge = edge_s if math.isfinite(edge_s) else None
    return replace(origin, stamp_source=source, clock=clock, clock_edge_s=edge)


def _source_id(name: str) -> str:
    # The same topic may exist on another computer or in another ROS domain.
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    return f"{_PREFIX}{naming.sanitise(socket.gethostname())}-{domain}-{name}"


def _content_type(origin: Origin, channels: Sequence[Channel]) -> str:
    """Return XDF's content type for poses, else the message's name."""
    is_pose = any(each.kind.startswith(("Position", "Orientation")) for each in channels)
    return ContentType.MOCAP.value if is_pose else origin.type_name.rpartition("/")[2]


def _describe(description: Element, origin: Origin, *, can_drop_samples: bool) -> None:
    synchronization = SubElement(description, "synchronization")
    _fill(synchronization, offset_mean="0")
    if can_drop_samples:
        # Without this flag pyxdf spreads a gap of less than 500 samples over the whole recording.
        _fill(synchronization, can_drop_samples="true")
    ros = SubElement(description, "ros")
    _fill(ros, topic=origin.topic, type=origin.type_name, type_hash=origin.type_hash)
    _fill(ros, **(origin.frames or {}))
    _fill(ros, stamp_source=origin.stamp_source.value, clock=origin.clock.value)
    if origin.clock_edge_s is not None:
        _fill(ros, clock_edge_s=f"{origin.clock_edge_s:.6f}")


def _fill(parent: Element, **fields: str) -> None:
    for name, text in fields.items():
        SubElement(parent, name).text = text
