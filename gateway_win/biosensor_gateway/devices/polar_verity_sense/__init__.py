"""Polar Verity Sense, OH1 and 360: optical heart-rate sensors for the arm or the temple."""

from biosensor_common import plausible
from biosensor_common.quantities import MAGNETIC_FIELD, ContentType, MessageType, Unit
from biosensor_common.spec import FROM_DEVICE, SensorSpec
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.devices import ble_heart_rate
from biosensor_gateway.devices.sensor import Sensor

_STRAP = ble_heart_rate.SPEC
_PPI = (
    *channels(Unit.SECONDS, "PPI", plausible=plausible.BEAT_INTERVAL_S),
    *channels(Unit.SECONDS, "error", plausible=plausible.BEAT_UNCERTAINTY_S),
)
_PPG = (
    *channels(Unit.COUNTS, "LED1", "LED2", "LED3"),
    *channels(Unit.COUNTS, "ambient", may_rest=True),
)
# The vendor calls its contact bit very unreliable, so it has no role and nothing depends on it.
_QUALITY = channels(Unit.BOOLEAN, "skin_contact", "moving")

SPEC = SensorSpec(
    name="polar_verity_sense",
    title="Polar Verity Sense, OH1, 360",
    manufacturer="Polar Electro",
    model="Verity Sense",
    streams=(
        _STRAP.stream("hr"),
        raw("ppi", ContentType.RR, _PPI),
        raw("ppg", ContentType.PPG, _PPG, FROM_DEVICE, chunk="ppg"),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G), FROM_DEVICE),
        hardware("gyro", ContentType.GYROSCOPE,
                 channels(Unit.DEGREES_PER_SECOND, *"XYZ",
                     plausible=plausible.ROTATION_DEG_S), FROM_DEVICE),
        hardware("mag", ContentType.MAGNETOMETER,
                 channels(Unit.MICROTESLA, *"XYZ", roles=MAGNETIC_FIELD,
                     plausible=plausible.MAGNETIC_FIELD_UT), FROM_DEVICE),
        _STRAP.stream("bat"),
        _STRAP.stream("rssi"),
        hardware("quality", ContentType.QUALITY, _QUALITY,
                 message_type=MessageType.FLOAT32_MULTI_ARRAY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_verity_sense.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.polar_verity_sense.simulator:SimulatedPolarVeritySense",
    },
)
