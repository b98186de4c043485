"""Zephyr BioHarness 3 over its Bluetooth serial port."""

from biosensor_common import plausible
from biosensor_common.quantities import ChannelFormat, ChannelRole, ContentType, MessageType, Unit
from biosensor_common.spec import ChannelSpec, NominalScale, SensorSpec
from biosensor_common.table import battery, channels, hardware, raw, signal_strength
from biosensor_gateway.devices.sensor import Sensor

# Nominal scale from the data sheet; other programs use up to 0.025 mV per count.
_ECG = ChannelSpec("ECG", Unit.COUNTS, NominalScale(0.013405, Unit.MILLIVOLTS, zero=512))
_QUALITY = (
    *channels(Unit.BOOLEAN, "worn", roles=[ChannelRole.CONTACT]),
    *channels(Unit.PERCENT, "hr_confidence", plausible=plausible.PERCENT),
    *channels(Unit.BOOLEAN, "hr_unreliable", "br_unreliable", "hrv_unreliable"),
    *channels(Unit.INDEX, "link_quality"),
)

SPEC = SensorSpec(
    name="zephyr",
    title="Zephyr BioHarness 3",
    manufacturer="Zephyr Technology",
    model="BioHarness 3",
    streams=(
        raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR",
            plausible=plausible.HEART_RATE_BPM), contract=True,
            channel_format=ChannelFormat.INT16, message_type=MessageType.UINT8),
        raw("hrv", ContentType.HRV, channels(Unit.MILLISECONDS, "SDNN",
            plausible=plausible.VARIABILITY_MS), contract=True,
            channel_format=ChannelFormat.INT32, message_type=MessageType.UINT16),
        raw("ecg", ContentType.ECG, (_ECG,), 250, chunk="ecg"),
        raw("br", ContentType.RESPIRATION_RATE, channels(Unit.BREATHS_PER_MINUTE, "rate",
            plausible=plausible.BREATHING_RATE_BPM),
            contract=True),
        # The original framework named the waveform's chunk after the rate's topic.
        raw("breathing", ContentType.RESPIRATION, channels(Unit.COUNTS, "chest expansion"),
            1000 / 56, chunk="br"),
        raw("ibi", ContentType.RR, channels(Unit.SECONDS, "RR",
            plausible=plausible.BEAT_INTERVAL_S)),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G), 50),
        raw("posture", ContentType.POSTURE, channels(Unit.DEGREES, "angle",
            plausible=plausible.ANGLE_DEG)),
        raw("activity", ContentType.ACTIVITY, channels(Unit.G, "VMU",
            plausible=plausible.ACTIVITY_G)),
        raw("st", ContentType.TEMPERATURE, channels(Unit.CELSIUS, "skin",
            plausible=plausible.TEMPERATURE_C)),
        battery(),
        signal_strength(),
        hardware("quality", ContentType.QUALITY, _QUALITY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.zephyr.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.zephyr.simulator:SimulatedZephyr",
        # Recorded data of a real BioHarness 3 instead of a simulated signal, repeated after 150 s.
        "recording": "biosensor_gateway.devices.zephyr.simulator:RecordedZephyr",
    },
    demo="recording",
)
