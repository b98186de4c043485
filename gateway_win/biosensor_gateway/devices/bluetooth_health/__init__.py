"""Any pulse oximeter, thermometer, bicycle or foot pod with a standard Bluetooth service."""

from biosensor_common import plausible
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import channels, raw
from biosensor_gateway.devices import ble_heart_rate
from biosensor_gateway.devices.sensor import Sensor

_STRAP = ble_heart_rate.SPEC
_OXIMETRY = (
    *channels(Unit.PERCENT, "SpO2", plausible=plausible.SATURATION_PERCENT),
    *channels(Unit.BEATS_PER_MINUTE, "pulse", plausible=plausible.HEART_RATE_BPM),
    # Pulse amplitude index.
    *channels(Unit.PERCENT, "PAI", plausible=plausible.PERCENT),
)
_MOVING = (
    *channels(Unit.METRES_PER_SECOND, "speed", plausible=plausible.SPEED_M_S),
    *channels(Unit.REVOLUTIONS_PER_MINUTE, "cadence", plausible=plausible.CADENCE_RPM),
)

SPEC = SensorSpec(
    name="bluetooth_health",
    title="Bluetooth health or sports device",
    # The manufacturer is known after connecting.
    manufacturer="",
    model="",
    streams=(
        raw("spo2", ContentType.OXIMETRY, _OXIMETRY),
        raw("temp", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "body",
            plausible=plausible.TEMPERATURE_C)),
        raw("running", ContentType.ACTIVITY, _MOVING),
        raw("cycling", ContentType.ACTIVITY, _MOVING),
        raw("power", ContentType.ACTIVITY, channels(Unit.WATTS, "power",
            plausible=plausible.POWER_W)),
        _STRAP.stream("bat"),
        _STRAP.stream("rssi"),
        _STRAP.stream("quality"),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.bluetooth_health.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.bluetooth_health.simulator:SimulatedHealthDevice",
    },
    precedence=-1,
)
