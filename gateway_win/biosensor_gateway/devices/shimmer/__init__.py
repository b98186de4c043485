"""Shimmer3 and Shimmer3R (LogAndStream firmware), over Bluetooth Classic."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelRole, ContentType, Unit
from biosensor_common.spec import FROM_DEVICE, SensorSpec
from biosensor_common.table import battery, channels, hardware, raw
from biosensor_gateway.devices.sensor import Sensor

_ELECTRODES = ("RA", "LA", "LL", "V1")
_QUALITY = (
    *channels(Unit.BOOLEAN, "electrodes", roles=[ChannelRole.CONTACT]),
    *channels(Unit.BOOLEAN, *_ELECTRODES),
)

SPEC = SensorSpec(
    name="shimmer",
    title="Shimmer3, Shimmer3R",
    manufacturer="Shimmer",
    model="Shimmer3",
    streams=(
        raw("ecg", ContentType.ECG, channels(Unit.MICROVOLTS, "LL-RA", "LA-RA", "V1",
            plausible=plausible.BIOPOTENTIAL_UV),
            FROM_DEVICE, chunk="ecg"),
        raw("emg", ContentType.EMG, channels(Unit.MICROVOLTS, "EMG1", "EMG2",
            plausible=plausible.BIOPOTENTIAL_UV),
            FROM_DEVICE, chunk="emg"),
        hardware("acc_low_noise", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G),
            FROM_DEVICE),
        hardware("acc_wide_range", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G),
            FROM_DEVICE),
        hardware("gyro", ContentType.GYROSCOPE,
            channels(Unit.DEGREES_PER_SECOND, *"XYZ",
                plausible=plausible.ROTATION_DEG_S), FROM_DEVICE),
        hardware("mag", ContentType.MAGNETOMETER, channels(Unit.LOCAL_FLUX, *"XYZ"), FROM_DEVICE),
        hardware("pressure", ContentType.PRESSURE, channels(Unit.PASCALS, "pressure",
            plausible=plausible.PRESSURE_PA),
            FROM_DEVICE),
        hardware("temp", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "case",
            plausible=plausible.TEMPERATURE_C), FROM_DEVICE),
        battery(),
        hardware("quality", ContentType.QUALITY, _QUALITY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.shimmer.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.shimmer.simulator:SimulatedExgUnit",
        "emg": "biosensor_gateway.devices.shimmer.simulator:SimulatedEmgUnit",
        "imu": "biosensor_gateway.devices.shimmer.simulator:SimulatedImuUnit",
        "3r": "biosensor_gateway.devices.shimmer.simulator:SimulatedShimmer3R",
    },
    # If a name does not identify the board, the GSR+ sensor gets the device.
    precedence=-1,
)
