"""Errors of recordings that this computer makes by itself, with reasons to decide by."""

from __future__ import annotations

from enum import Enum, unique
from typing import TYPE_CHECKING

from biosensor_common.errors import GatewayError

if TYPE_CHECKING:
    from biosensor_gateway.recording.xdf.verdict import Verdict


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


class NotClosedError(RecorderError):
    """A recording ended, and its file was not closed.

    Attributes
    ----------
    why
        Why that is, as far as it is known.
    verdict
        What can be said of the file; None if nothing of it can be read.
    """

    def __init__(self, message: str, why: str, verdict: Verdict | None) -> None:
        super().__init__(RecorderReason.NOT_CLOSED, message)
        self.why, self.verdict = why, verdict
