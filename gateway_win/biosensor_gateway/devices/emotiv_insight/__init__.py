"""Emotiv Insight headset, connected through the Cortex service."""

from biosensor_common import plausible
from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelRole,
    ContentType,
    Unit,
)
from biosensor_common.spec import FROM_DEVICE, SensorSpec
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.devices.sensor import Sensor

_ELECTRODES = ("AF3", "T7", "Pz", "T8", "AF4")
_BANDS = ("theta", "alpha", "betaL", "betaH", "gamma")
_BAND_POWER = channels(
    Unit.MICROVOLTS_SQUARED_PER_HERTZ,
    *(f"{electrode}/{band}" for electrode in _ELECTRODES for band in _BANDS),
    plausible=plausible.BAND_POWER_UV2_PER_HZ,
)
_METRICS = channels(
    Unit.FRACTION,
    "engagement", "excitement", "long_term_excitement", "stress", "relaxation", "interest",
    "focus", "attention",
)  # fmt: skip
_MOTION = (
    *channels(Unit.NONE, "Q0", "Q1", "Q2", "Q3", roles=ORIENTATION),
    *channels(
        Unit.G, "ACCX", "ACCY", "ACCZ", roles=ACCELERATION, plausible=plausible.ACCELERATION_G
    ),
    *channels(
        Unit.MICROTESLA,
        "MAGX",
        "MAGY",
        "MAGZ",
        roles=MAGNETIC_FIELD,
        plausible=plausible.MAGNETIC_FIELD_UT,
    ),
)
# Battery and Signal are grades: 0 to 4, and 0 to 1 or 0 to 2 depending on the Cortex version.
_DEVICE = (
    *channels(Unit.INDEX, "Battery", "Signal", *_ELECTRODES),
    *channels(Unit.PERCENT, "OVERALL", plausible=plausible.PERCENT),
    *channels(
        Unit.PERCENT,
        "BatteryPercent",
        roles=[ChannelRole.STATE_OF_CHARGE],
        plausible=plausible.PERCENT,
    ),
)
_EEG_STATUS = (
    *channels(Unit.INDEX, "COUNTER"),
    *channels(Unit.BOOLEAN, "INTERPOLATED"),
    *channels(Unit.INDEX, "RAW_CQ"),
    *channels(Unit.BOOLEAN, "MARKER_HARDWARE"),
)

SPEC = SensorSpec(
    name="emotiv_insight",
    title="Emotiv Insight",
    manufacturer="Emotiv",
    model="Insight",
    streams=(
        raw("eeg", ContentType.EEG, channels(Unit.MICROVOLTS, *_ELECTRODES,
            plausible=plausible.BIOPOTENTIAL_UV), 128, chunk="eeg",
            contract=True),
        raw("pow", ContentType.EEG_BANDPOWER, _BAND_POWER, 8, chunk="pow", contract=True),
        raw("met", ContentType.PERFORMANCE_METRICS, _METRICS, contract=True),
        hardware("mot", ContentType.MOCAP, _MOTION, FROM_DEVICE, contract=True),
        hardware("dev", ContentType.STATUS, _DEVICE, is_state=True, contract=True),
        hardware("eeg_status", ContentType.STATUS, _EEG_STATUS, 128),
        # Only older firmware sends it, in an undocumented unit.
        hardware("gyro", ContentType.MOCAP, channels(Unit.ARBITRARY, *"XYZ"), FROM_DEVICE),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    service="EMOTIV Launcher",
    driver="biosensor_gateway.devices.emotiv_insight.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.emotiv_insight.simulator:SimulatedCortex",
    },
)
