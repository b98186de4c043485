"""Movesense Medical, Active and Flash: ECG, movement and heart rate on a chest strap."""

from biosensor_common import plausible
from biosensor_common.quantities import ACCELERATION, MAGNETIC_FIELD, ContentType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.devices import ble_heart_rate
from biosensor_gateway.devices.sensor import Sensor

_STRAP = ble_heart_rate.SPEC

SPEC = SensorSpec(
    name="movesense",
    title="Movesense",
    manufacturer="Movesense",
    model="",
    streams=(
        _STRAP.stream("hr"),
        _STRAP.stream("ibi"),
        raw("ecg", ContentType.ECG, channels(Unit.MICROVOLTS, "ECG",
            plausible=plausible.BIOPOTENTIAL_UV), 200, chunk="ecg"),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ", roles=ACCELERATION,
            plausible=plausible.ACCELERATION_G),
            52),
        hardware("gyro", ContentType.GYROSCOPE, channels(Unit.DEGREES_PER_SECOND, *"XYZ",
            plausible=plausible.ROTATION_DEG_S), 52),
        hardware("mag", ContentType.MAGNETOMETER,
            channels(Unit.MICROTESLA, *"XYZ", roles=MAGNETIC_FIELD,
                plausible=plausible.MAGNETIC_FIELD_UT), 52),
        # Temperature of the device itself, which the skin warms.
        hardware("temp", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "device",
            plausible=plausible.TEMPERATURE_C)),
        _STRAP.stream("bat"),
        _STRAP.stream("rssi"),
        _STRAP.stream("quality"),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.movesense.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.movesense.simulator:SimulatedMovesense",
    },
)
