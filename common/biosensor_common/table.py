"""Constructors for declarations, which read like a table."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from biosensor_common import plausible as bounds
from biosensor_common.quantities import (
    Category,
    ChannelFormat,
    ChannelRole,
    ContentType,
    MessageType,
    Unit,
)
from biosensor_common.spec import IRREGULAR, ChannelSpec, FromDevice, StreamSpec


def channels(
    unit: str,
    *labels: str,
    roles: Iterable[ChannelRole] = (),
    plausible: tuple[float, float] | str | None = None,
    may_rest: bool = False,
) -> tuple[ChannelSpec, ...]:
    """Return channels with the same unit and bounds, in order; *roles* has one role per channel."""
    each = tuple(roles) or (None,) * len(labels)
    return tuple(
        ChannelSpec(label, unit, role=role, plausible=plausible, may_rest=may_rest)
        for label, role in zip(labels, each, strict=True)
    )


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
    is_state: bool = False,
) -> StreamSpec:
    """Build one stream; by default ``Float32`` for one channel and an array for several."""
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
        is_state=is_state,
    )


raw = partial(row, category=Category.RAW)
hardware = partial(row, category=Category.HARDWARE)


def battery(*, contract: bool = False) -> StreamSpec:
    """Build the stream of a device's battery charge."""
    level = channels(
        Unit.PERCENT, "level", roles=[ChannelRole.STATE_OF_CHARGE], plausible=bounds.PERCENT
    )
    return hardware("bat", ContentType.BATTERY, level, contract=contract, is_state=True)


def signal_strength() -> StreamSpec:
    """Build the stream of a device's signal strength."""
    signal = channels(
        Unit.DBM,
        "signal",
        roles=[ChannelRole.SIGNAL_STRENGTH],
        plausible=bounds.SIGNAL_STRENGTH_DBM,
    )
    return hardware("rssi", ContentType.RSSI, signal, is_state=True)
