"""Errors of recordings that this computer makes by itself, with reasons to decide by."""

from __future__ import annotations

from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class RecorderReason(Enum):
    """Why a recording was not begun, or not ended as it should be."""

    NO_PROGRAM = "no_program"
    """LabRecorder's program is not here."""
    RECORDING = "recording"
    """It is recording already."""
    NOT_RECORDING = "not_recording"
    EXISTS = "exists"
    """The file is there already."""
    UNWRITABLE = "unwritable"
    """The file or the state folder cannot be written."""
    STREAMS_MISSING = "streams_missing"
    NOT_BEGUN = "not_begun"
    """The program ended, or did not open all streams in time."""
    NOT_CLOSED = "not_closed"
    """The program ended, and its file was not closed."""


class RecorderError(GatewayError):
    """A recording was not begun, or not ended as it should be."""
