"""Reads what a stream says of itself."""

from __future__ import annotations

import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.stream_header import (
    MAX_FIELD_CHARACTERS,
    CoreFields,
    StreamHeader,
    foreign_header,
)


def about(info: pylsl.StreamInfo) -> str:
    """Return what people know a stream by."""
    return f"LSL stream {info.name()[:MAX_FIELD_CHARACTERS]!r} of {info.hostname()}"


def header_of(info: pylsl.StreamInfo, core: CoreFields, refusals: Refusals) -> StreamHeader:
    """Return a stream's header; of a description that cannot be read, what LSL itself says."""
    try:
        header = read_header(info.as_xml())
    except SpecError as error:
        # What cannot be parsed does not say whose it is.
        why = str(error).removeprefix(f"{core}: ")
        refusals.refuse(Refusal.NO_DESCRIPTION, about=about(info), why=why)
        return foreign_header(core)
    refusals.over(Refusal.NO_DESCRIPTION, about(info))
    return header
