"""Declares the agent's own streams, and counts each stream's samples on their way into LSL."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from biosensor_common.device_clock import ClockState
from biosensor_common.naming import AGENT
from biosensor_common.quantities import ChannelFormat, ContentType, MessageType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import channels, hardware

GATEWAY = SensorSpec(
    name=AGENT,
    title="Biosensor Gateway capture agent",
    manufacturer="Biosensor Gateway",
    model="capture agent",
    streams=(
        hardware("counters", ContentType.COUNTERS, channels(Unit.NONE, "counters"), 1,
                 channel_format=ChannelFormat.STRING, message_type=MessageType.DIAGNOSTIC_ARRAY),
        hardware("events", ContentType.MARKERS, channels(Unit.NONE, "event"),
                 channel_format=ChannelFormat.STRING, message_type=MessageType.STRING),
        hardware("markers", ContentType.MARKERS, channels(Unit.NONE, "marker"),
                 channel_format=ChannelFormat.STRING, message_type=MessageType.STRING),
    ),
)  # fmt: skip


@dataclass(slots=True)
class Counters:
    """Counts of one stream's samples on their way into LSL."""

    pushed: int = 0  # Samples handed to LSL.
    lost: int = 0  # Samples that the device measured but that never reached the agent.
    refused: int = 0  # Samples that failed the check of range, shape or stamp.
    last_stamp: float = 0.0  # LSL time of the newest sample, 0 before the first.
    withheld: int = 0  # Samples that reached the agent but were not sent, because of a pause.
    # Samples that arrived before the first receiver; the newest of them are pushed to it.
    waited: int = field(default=0, compare=False)


def counters_text(
    counters: Mapping[str, Counters],
    clocks: Mapping[str, ClockState] | None = None,
    refused: Mapping[str, Sequence[str]] | None = None,
    off: Collection[str] = (),
    away: Mapping[str, str] | None = None,
    of_devices: Mapping[str, Sequence[str]] | None = None,
    lacking: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Sample of the ``counters`` stream: JSON, by source_id.

    The state of a device's clock is in the entry of one of its streams, together with sentences
    about data that were left out but belong to no single stream. Sentences about data of a stream
    that are currently left out or changed are in its own entry. Streams that are *off*, because
    the settings or the device's model do not have them, are marked: nothing of them is missing.
    Channels that the model is *lacking* are listed by label. While a device is *away*, each of its
    streams has the device's state, as in heartbeats, because its last data are old.

    The node compares ``pushed`` with what it pulled up to ``last_stamp``. Samples suppressed by a
    pause are not counted here: the number of beats in a second is a heart rate.
    """
    return json.dumps(
        {
            source_id: {
                "pushed": c.pushed,
                "lost": c.lost,
                "last_stamp": c.last_stamp,
                **_clock_entry((clocks or {}).get(source_id)),
                **_refused_entry((refused or {}).get(source_id, ())),
                **({"off": True} if source_id in off else {}),
                **_refused_entry((lacking or {}).get(source_id, ()), "lacking"),
                **_refused_entry((of_devices or {}).get(source_id, ()), "of_device"),
                **({"away": away[source_id]} if away and source_id in away else {}),
            }
            for source_id, c in counters.items()
        },
        separators=(",", ":"),
    )


def _refused_entry(sentences: Sequence[str], key: str = "refused") -> dict[str, Sequence[str]]:
    return {key: sentences} if sentences else {}


def _clock_entry(clock: ClockState | None) -> dict[str, dict[str, float]]:
    if clock is None or not math.isfinite(clock.offset_s):
        return {}
    return {
        "clock": {
            "offset_s": round(clock.offset_s, 6),
            "drift_ppm": round(clock.drift_ppm, 2),
            "residual_rms_s": round(clock.residual_rms_s, 6),
            "reanchors": clock.reanchors,
        }
    }
