"""Polar straps and watches that advertise their heart rate, read without a connection."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelRole, ContentType, MessageType, Unit
from biosensor_common.spec import ChannelSpec, SensorSpec
from biosensor_common.table import channels, hardware, raw, signal_strength
from biosensor_gateway.devices.sensor import Sensor

SPEC = SensorSpec(
    name="polar_broadcast",
    title="Polar heart rate without a connection",
    manufacturer="Polar",
    # The model is part of the device's name.
    model="",
    streams=(
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM)),
        raw("hr_fast", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM)),
        signal_strength(),
        hardware("quality", ContentType.QUALITY,
            (ChannelSpec("contact", Unit.BOOLEAN, role=ChannelRole.CONTACT),
             ChannelSpec("battery_ok", Unit.BOOLEAN)),
                 message_type=MessageType.FLOAT32_MULTI_ARRAY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_broadcast.driver:DRIVER",
    virtual={"": "biosensor_gateway.devices.polar_broadcast.simulator:SimulatedPolarBroadcast"},
    # A connection provides more data, so it is preferred.
    precedence=-2,
)
