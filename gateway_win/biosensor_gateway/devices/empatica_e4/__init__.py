"""Empatica E4 wristband, connected through the vendor's streaming server."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelFormat, ChannelRole, ContentType, MessageType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import battery, channels, hardware, raw
from biosensor_gateway.devices.sensor import Sensor

_QUALITY = (
    *channels(Unit.BOOLEAN, "worn", roles=[ChannelRole.CONTACT]),
    *channels(Unit.FRACTION, "loss"),
)

SPEC = SensorSpec(
    name="empatica_e4",
    title="Empatica E4",
    manufacturer="Empatica",
    model="E4",
    streams=(
        raw("bvp", ContentType.PPG, channels(Unit.ARBITRARY, "BVP"), 64, chunk="bvp",
            contract=True),
        raw("gsr", ContentType.GSR, channels(Unit.MICROSIEMENS, "EDA",
            plausible=plausible.CONDUCTANCE_US), 4, chunk="gsr",
            contract=True),
        raw("st", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "skin",
            plausible=plausible.TEMPERATURE_C), 4, chunk="st",
            contract=True),
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM), contract=True),
        raw("ibi", ContentType.RR, channels(Unit.SECONDS, "IBI",
            plausible=plausible.BEAT_INTERVAL_S), contract=True),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G), 32, contract=True),
        battery(contract=True),
        hardware("tag", ContentType.MARKERS, channels(Unit.NONE, "event"), contract=True,
                 channel_format=ChannelFormat.STRING, message_type=MessageType.EMPTY),
        hardware("quality", ContentType.QUALITY, _QUALITY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    service="E4 streaming server",
    driver="biosensor_gateway.devices.empatica_e4.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.empatica_e4.simulator:SimulatedE4",
    },
)
