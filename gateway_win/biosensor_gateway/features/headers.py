"""Writes the headers of streams of features."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pylsl

from biosensor_common import naming
from biosensor_common.lsl_header import append_children, describe
from biosensor_common.spec import IRREGULAR, DeviceInfo
from biosensor_common.stream_header import BLOCK, PREFIX, Replay, mark_as_replay
from biosensor_gateway.features.outputs import VERSION, Feature
from biosensor_gateway.features.sources import Source


def is_feature(xml: str) -> bool:
    """Whether a stream's full description says that it was computed here."""
    return f"<{BLOCK}>" in xml


def stream_info(source: Source, feature: Feature) -> pylsl.StreamInfo:
    """Return the header of a feature's stream.

    In addition to the usual header of our streams, it has below ``desc``::

        <features>
          <derived_from>polar_h10-…-ecg</derived_from> <source_id>…</source_id>
          <algorithm>…</algorithm> <version>5</version>
          <window_s>10.0</window_s> <delay_s>0.3</delay_s> <holds_s>5.3</holds_s>
        </features>

    A feature of a replayed stream is marked as a replay.
    """
    stream, replay = feature.stream, source.header.replay
    source_id = naming.source_id(source.identity, stream.data_name)
    desc = describe(stream, source.identity, DeviceInfo(model=feature.algorithm))
    _add_origin(desc, source, feature)
    if replay is not None:
        mark_as_replay(
            desc, Replay(replay.file, source_id, IRREGULAR, replay.speed, replay.start_s)
        )
        # The hash of the recording, taken from the replayed stream's source_id.
        played = source.source_id.removeprefix(PREFIX).partition(":")[0]
        source_id = f"{PREFIX}{played}:{source_id}"
    info = pylsl.StreamInfo(
        naming.lsl_name(source.identity, stream.data_name),
        stream.content_type.value,
        len(stream.channels),
        IRREGULAR,
        stream.format.value,
        source_id,
    )
    append_children(info.desc(), desc)
    return info


def _add_origin(desc: ET.Element, source: Source, feature: Feature) -> None:
    block = ET.SubElement(desc, BLOCK)
    for name, text in (
        ("derived_from", source.name),
        ("source_id", source.source_id),
        ("algorithm", feature.algorithm),
        ("version", VERSION),
        ("window_s", repr(float(feature.window_s))),
        ("delay_s", repr(float(feature.delay_s))),
        ("holds_s", repr(float(feature.holds_s))),
    ):
        ET.SubElement(block, name).text = text
