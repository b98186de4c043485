"""Declares the agent's own streams: counters, events and markers."""

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
