"""What an Acme Band emits."""

from biosensor_common.quantities import ChannelRole, ContentType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import battery, channels, hardware, raw

RATE_HZ = 50

SPEC = SensorSpec(
    name="acme_band",
    title="Acme Band",
    manufacturer="Acme",
    model="Band",
    streams=(
        raw("force", ContentType.RESPIRATION, channels(Unit.NEWTONS, "force"), RATE_HZ,
            chunk="force"),
        battery(),
        hardware("quality", ContentType.QUALITY,
                 channels(Unit.BOOLEAN, "worn", roles=[ChannelRole.CONTACT]), is_state=True),
    ),
)  # fmt: skip
