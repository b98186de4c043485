"""Shimmer3 GSR+ (LogAndStream firmware), over Bluetooth Classic."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelRole, ContentType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import battery, channels, hardware, raw
from biosensor_gateway.devices.sensor import Sensor

_QUALITY = (
    *channels(Unit.BOOLEAN, "electrodes", roles=[ChannelRole.CONTACT]),
    *channels(Unit.INDEX, "gsr_range"),
    *channels(Unit.BOOLEAN, "pulse_found"),
)

SPEC = SensorSpec(
    name="shimmer3_gsr",
    title="Shimmer3 GSR+",
    manufacturer="Shimmer",
    model="Shimmer3 GSR+",
    streams=(
        raw("gsr", ContentType.GSR, channels(Unit.MICROSIEMENS, "EDA",
            plausible=plausible.CONDUCTANCE_US), 128, chunk="gsr",
            contract=True),
        raw("ppg", ContentType.PPG, channels(Unit.MILLIVOLTS, "PPG",
            plausible=plausible.PULSE_PROBE_MV), 128, chunk="ppg",
            contract=True),
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM)),
        battery(),
        hardware("quality", ContentType.QUALITY, _QUALITY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.shimmer3_gsr.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.shimmer3_gsr.simulator:SimulatedShimmer3",
    },
    introduces=True,
)
