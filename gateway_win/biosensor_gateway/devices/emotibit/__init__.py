"""EmotiBit: skin conductance, pulse at three wavelengths, temperature and motion.

Rates are those of the stock firmware; units and ranges are as it computes them. Source:
EmotiBit_FeatherWing (`EmotiBit.cpp`) and *Working with EmotiBit data* (MIT licence).
"""

from biosensor_common import plausible
from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ContentType,
    Unit,
)
from biosensor_common.spec import FROM_DEVICE, SensorSpec
from biosensor_common.table import battery, channels, hardware, raw
from biosensor_gateway.devices.sensor import Sensor

MOTION_HZ = 25.0
CONDUCTANCE_HZ = 15.0
TEMPERATURE_HZ = 7.5

_TOO_MUCH = channels(Unit.COUNTS, "clipped", "overflowed")

SPEC = SensorSpec(
    name="emotibit",
    title="EmotiBit",
    manufacturer="EmotiBit",
    model="EmotiBit",
    streams=(
        raw("eda", ContentType.GSR, channels(Unit.MICROSIEMENS, "EDA",
            plausible=plausible.CONDUCTANCE_US), CONDUCTANCE_HZ,
            chunk="eda"),
        # One firmware variant measures it at 100 Hz.
        raw("ppg", ContentType.PPG, channels(Unit.COUNTS, "infrared", "red", "green"),
            FROM_DEVICE, chunk="ppg"),
        raw("st", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "skin",
            plausible=plausible.TEMPERATURE_C), TEMPERATURE_HZ),
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM)),
        raw("ibi", ContentType.RR, channels(Unit.SECONDS, "IBI",
            plausible=plausible.BEAT_INTERVAL_S)),
        hardware("acc", ContentType.ACCELEROMETER,
                 channels(Unit.G, *"XYZ", roles=ACCELERATION,
                     plausible=plausible.ACCELERATION_G), MOTION_HZ),
        hardware("gyro", ContentType.GYROSCOPE,
                 channels(Unit.DEGREES_PER_SECOND, *"XYZ",
                     plausible=plausible.ROTATION_DEG_S), MOTION_HZ),
        hardware("mag", ContentType.MAGNETOMETER,
                 channels(Unit.MICROTESLA, *"XYZ", roles=MAGNETIC_FIELD,
                     plausible=plausible.MAGNETIC_FIELD_UT), MOTION_HZ),
        battery(),
        # Number of samples beyond a sensor's range, and of samples lost in a full buffer.
        hardware("quality", ContentType.QUALITY, _TOO_MUCH),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.emotibit.driver:DRIVER",
    virtual={"": "biosensor_gateway.devices.emotibit.simulator:SimulatedEmotiBit"},
)
