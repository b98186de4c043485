"""Any strap that offers the Bluetooth Heart Rate Service."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelRole, ContentType, MessageType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import battery, channels, hardware, raw, signal_strength
from biosensor_gateway.devices.sensor import Sensor

SPEC = SensorSpec(
    name="ble_heart_rate",
    title="Bluetooth heart-rate strap",
    # The manufacturer is known after connecting.
    manufacturer="",
    model="",
    streams=(
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM)),
        raw("ibi", ContentType.RR, channels(Unit.SECONDS, "RR",
            plausible=plausible.BEAT_INTERVAL_S)),
        battery(),
        signal_strength(),
        hardware("quality", ContentType.QUALITY,
            channels(Unit.BOOLEAN, "contact", roles=[ChannelRole.CONTACT]),
                 message_type=MessageType.FLOAT32_MULTI_ARRAY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.ble_heart_rate.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.ble_heart_rate.simulator:SimulatedHeartRateStrap",
    },
    precedence=-1,
)
