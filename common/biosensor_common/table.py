"""Short constructors, so that a declaration reads like the table it is."""

from __future__ import annotations

from functools import partial

from biosensor_common.quantities import Category, ChannelFormat, ContentType, MessageType, Unit
from biosensor_common.spec import IRREGULAR, ChannelSpec, FromDevice, StreamSpec


def channels(unit: Unit, *labels: str) -> tuple[ChannelSpec, ...]:
    """Channels that share one unit, in wire order."""
    return tuple(ChannelSpec(label, unit) for label in labels)


def row(
    data_name: str,
    content_type: ContentType,
    channel_specs: tuple[ChannelSpec, ...],
    rate: float | FromDevice = IRREGULAR,
    *,
    category: Category,
    channel_format: ChannelFormat = ChannelFormat.FLOAT32,
    message_type: MessageType | None = None,
    chunk: str = "",
    contract: bool = False,
) -> StreamSpec:
    """Build one stream; ``Float32`` for one channel and an array for several, if not said."""
    if message_type is None:
        several = len(channel_specs) > 1
        message_type = MessageType.FLOAT32_MULTI_ARRAY if several else MessageType.FLOAT32
    return StreamSpec(
        data_name=data_name,
        category=category,
        content_type=content_type,
        channels=channel_specs,
        rate=rate,
        format=channel_format,
        message_type=message_type,
        chunk=chunk,
        contract=contract,
    )


raw = partial(row, category=Category.RAW)
hardware = partial(row, category=Category.HARDWARE)
