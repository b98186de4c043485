"""Vernier Go Direct respiration belt (GDX-RB), over Bluetooth LE."""

from biosensor_common import plausible
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import FROM_DEVICE, SensorSpec
from biosensor_common.table import battery, channels, hardware, raw, signal_strength
from biosensor_gateway.devices.sensor import Sensor

# tension: -1 loose, 0 good, 1 tight.
_QUALITY = (
    *channels(Unit.BOOLEAN, "rate_valid"),
    *channels(Unit.INDEX, "tension"),
)

SPEC = SensorSpec(
    name="vernier_respiration_belt",
    title="Vernier Go Direct Respiration Belt",
    manufacturer="Vernier",
    model="GDX-RB",
    streams=(
        raw("bpm", ContentType.RESPIRATION_RATE, channels(Unit.BREATHS_PER_MINUTE, "rate",
            plausible=plausible.BREATHING_RATE_BPM),
            FROM_DEVICE, chunk="bpm", contract=True),
        raw("force", ContentType.RESPIRATION, channels(Unit.NEWTONS, "force",
            plausible=plausible.FORCE_N),
            FROM_DEVICE, chunk="force", contract=True),
        battery(),
        signal_strength(),
        hardware("quality", ContentType.QUALITY, _QUALITY),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.vernier_respiration_belt.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.vernier_respiration_belt.simulator:SimulatedBelt",
    },
    introduces=True,
)
