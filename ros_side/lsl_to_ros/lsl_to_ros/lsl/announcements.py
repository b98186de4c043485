"""Reads what an LSL stream announces of itself, and judges what can be used."""

from __future__ import annotations

import pylsl

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import MAX_CHANNELS
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields

BUFFER_S = 360
# What other programs announce may be anything, and liblsl would reserve memory for it.
BUFFER_SAMPLES = 4_000_000
MAX_RATE_HZ = 1e6

_FORMATS = {
    pylsl.cf_float32: ChannelFormat.FLOAT32,
    pylsl.cf_double64: ChannelFormat.DOUBLE64,
    pylsl.cf_string: ChannelFormat.STRING,
    pylsl.cf_int32: ChannelFormat.INT32,
    pylsl.cf_int16: ChannelFormat.INT16,
    pylsl.cf_int8: ChannelFormat.INT8,
    pylsl.cf_int64: ChannelFormat.INT64,
}


def read_core(info: pylsl.StreamInfo) -> CoreFields:
    """Return what a stream announces of itself.

    Raises
    ------
    SpecError
        ``INVALID``, if it has no channels, too many, or an impossible rate.
    """
    if not 0 < info.channel_count() <= MAX_CHANNELS:
        message = f"LSL stream {info.name()!r}: {info.channel_count()} channels are not usable"
        raise SpecError(SpecReason.INVALID, message)
    if not 0 <= info.nominal_srate() <= MAX_RATE_HZ:
        message = f"LSL stream {info.name()!r}: {info.nominal_srate()} Hz is no possible rate"
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


def buffer_length(rate: float) -> int:
    """Return the seconds to buffer; hundreds of samples where the rate is 0, as liblsl has it."""
    return BUFFER_S if rate * BUFFER_S <= BUFFER_SAMPLES else max(1, int(BUFFER_SAMPLES / rate))
