"""Recordings and bags to convert, and what is in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from tests.xdf import xdf_file

DATE = "2026-03-14T10:30:00+01:00"
FILE_HEADER = f"<?xml version='1.0'?><info><version>1.0</version><datetime>{DATE}</datetime></info>"
UNTOLD_RATE_HZ = 64.0
OWN_MESSAGES = Path(__file__).parents[2] / "ros_side" / "biosensor_msgs" / "msg"


def dated(*parts: bytes) -> bytes:
    """Return a file whose recorder told the date."""
    return b"".join([b"XDF:", xdf_file.chunk(1, FILE_HEADER.encode(), 4), *parts])


def declared(
    number: int, sensor: str, data: str, participant: str = "", label: str = ""
) -> tuple[bytes, int]:
    """Return the header of a stream of ours, as the agent declares it, and its channels."""
    stream = declaration(sensor).stream(data)
    identity = DeviceIdentity(sensor, "U1", participant, label)
    rate = UNTOLD_RATE_HZ if isinstance(stream.rate, FromDevice) else stream.rate
    header = xdf_file.stream_header(
        number,
        lsl_name(identity, data),
        kind=stream.content_type.value,
        channels=len(stream.channels),
        rate=rate,
        fmt=stream.format.value,
        source_id=source_id(identity, data),
        desc=describe(stream, identity, DeviceInfo()),
    )
    return header, len(stream.channels)


def described(labels: Sequence[str], units: Sequence[str]) -> ET.Element:
    """Return what another program's header says of its channels."""
    desc = ET.Element("desc")
    channels = ET.SubElement(desc, "channels")
    for label, unit in zip(labels, units, strict=True):
        node = ET.SubElement(channels, "channel")
        ET.SubElement(node, "label").text = label
        ET.SubElement(node, "unit").text = unit
    return desc


def to_bag(recording: Path, bag: Path, selection: Selection = Selection()) -> Outcome:  # noqa: B008
    """Export a recording as `xdf export --to mcap` does."""
    task = Task(("mcap",), selection, output=bag)
    return export(recording, task, lambda _name, _s: lambda _done: None)


class Held:
    """All that a recording holds of one stream."""

    def __init__(
        self, xml: str, offsets: Any, stamps: NDArray[np.float64], values: NDArray[Any] | list[Any]
    ) -> None:
        self.xml, self.offsets, self.stamps, self.values = xml, offsets, stamps, values

    @property
    def bits(self) -> Any:
        """The values, to the bit."""
        return self.values if isinstance(self.values, list) else self.values.tobytes()


def held(recording: Path) -> list[Held]:
    """Return the streams of a recording, in its order."""
    with open_contents(recording) as contents:
        assert not contents.damages
        return [_held(stream) for stream in contents.streams]


def _held(stream: Any) -> Held:
    blocks = list(stream.blocks())
    stamps = np.concatenate([np.empty(0), *(each.stamps for each in blocks)])
    values: Any = [sample for each in blocks for sample in each.values]
    if values and not isinstance(values[0], tuple):
        values = np.concatenate([each.values for each in blocks])
    return Held(stream.header.xml, stream.clock_offsets, stamps, values)


def typestore() -> Typestore:
    """Return the messages of Jazzy, and our own by the files that colcon builds."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in OWN_MESSAGES.glob("*.msg"):
        store.register(get_types_from_msg(file.read_text(), f"biosensor_msgs/msg/{file.stem}"))
    return store


def write_bag(
    folder: Path,
    messages: Iterable[tuple[str, str, int, Any]],
    storage: StoragePlugin = StoragePlugin.MCAP,
    store: Typestore | None = None,
) -> None:
    """Write topic, type, time in ns and message of each, by the library."""
    types = store or typestore()
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, unix_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], unix_ns, types.serialize_cdr(message, kind))
