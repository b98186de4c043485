"""Muse 2, Muse S and Muse S Athena: EEG at four places of the head, light, movement."""

from biosensor_common import plausible
from biosensor_common.quantities import ACCELERATION, ContentType, Unit
from biosensor_common.spec import ChannelSpec, SensorSpec
from biosensor_common.table import battery, channels, hardware, raw, signal_strength
from biosensor_gateway.devices.sensor import Sensor

EEG_HZ, LIGHT_HZ, MOTION_HZ = 256, 64, 52
LIGHT_LABELS = (
    *("LO_NIR", "RO_NIR", "LO_IR", "RO_IR", "LI_NIR", "RI_NIR", "LI_IR", "RI_IR"),
    *("LO_RED", "RO_RED", "LO_AMB", "RO_AMB", "LI_RED", "RI_RED", "LI_AMB", "RI_AMB"),
)
"""Left or right, outer or inner; 730 nm, 850 nm, red, ambient light; names as in OpenMuse."""

SPEC = SensorSpec(
    name="muse",
    title="Muse 2, Muse S, Muse S Athena",
    manufacturer="InteraXon",
    model="",
    streams=(
        raw("eeg", ContentType.EEG, channels(Unit.MICROVOLTS, "TP9", "AF7", "AF8", "TP10",
            plausible=plausible.BIOPOTENTIAL_UV),
            EEG_HZ, chunk="eeg"),
        raw("aux", ContentType.EEG,
            channels(Unit.MICROVOLTS, "AUX1", "AUX2", "AUX3", "AUX4",
                plausible=plausible.BIOPOTENTIAL_UV, may_rest=True), EEG_HZ),
        raw("ppg", ContentType.PPG,
            (*channels(Unit.COUNTS, "ambient", may_rest=True),
             *channels(Unit.COUNTS, "infrared", "red")), LIGHT_HZ),
        raw("optics", ContentType.PPG,
            tuple(ChannelSpec(each, Unit.COUNTS, may_rest=each.endswith("_AMB"))
                  for each in LIGHT_LABELS), LIGHT_HZ),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ", roles=ACCELERATION,
            plausible=plausible.ACCELERATION_G),
            MOTION_HZ),
        hardware("gyro", ContentType.GYROSCOPE, channels(Unit.DEGREES_PER_SECOND, *"XYZ",
            plausible=plausible.ROTATION_DEG_S),
            MOTION_HZ),
        battery(),
        signal_strength(),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.muse.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.muse.simulator:SimulatedMuse",
        "athena": "biosensor_gateway.devices.muse.simulator:SimulatedAthena",
    },
)
