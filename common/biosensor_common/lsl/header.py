"""Reads the core fields and the description of an LSL stream, and rejects unusable ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import MAX_CHANNELS, read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header

if TYPE_CHECKING:
    import pylsl

MAX_RATE_HZ = 1e6

# In the order of liblsl's enum lsl_channel_format_t.
_FORMATS = {
    1: ChannelFormat.FLOAT32,
    2: ChannelFormat.DOUBLE64,
    3: ChannelFormat.STRING,
    4: ChannelFormat.INT32,
    5: ChannelFormat.INT16,
    6: ChannelFormat.INT8,
    7: ChannelFormat.INT64,
}


def read_core(info: pylsl.StreamInfo) -> CoreFields:
    """Return the core fields that a stream announces.

    Raises
    ------
    SpecError
        ``INVALID``, if it has no channels, too many, an impossible rate or an unknown format.
    """
    if not 0 < info.channel_count() <= MAX_CHANNELS:
        message = f"LSL stream {info.name()!r}: {info.channel_count()} channels are not usable"
        raise SpecError(SpecReason.INVALID, message)
    if not 0 <= info.nominal_srate() <= MAX_RATE_HZ:
        message = f"LSL stream {info.name()!r}: {info.nominal_srate()} Hz is not a possible rate"
        raise SpecError(SpecReason.INVALID, message)
    if info.channel_format() not in _FORMATS:
        message = f"LSL stream {info.name()!r}: its format {info.channel_format()} is unknown"
        raise SpecError(SpecReason.INVALID, message)
    return CoreFields(
        name=info.name(),
        content_type=info.type(),
        source_id=info.source_id(),
        hostname=info.hostname(),
        channel_count=info.channel_count(),
        rate=info.nominal_srate(),
        format=_FORMATS[info.channel_format()],
    )


def header_or_foreign(xml: str, core: CoreFields) -> tuple[StreamHeader, str]:
    """Return the header of a full description, and the error if it cannot be read.

    A description that cannot be read does not identify its program. The stream then gets the
    header of a foreign stream, made from the core fields.
    """
    try:
        return read_header(xml), ""
    except SpecError as error:
        return foreign_header(core), str(error).removeprefix(f"{core}: ")


def decoded(text: bytes) -> str:
    """Decode text as pylsl decodes names: as UTF-8, else in the code page of Windows programs."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")
