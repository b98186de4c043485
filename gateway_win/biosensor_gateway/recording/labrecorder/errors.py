"""Errors of LabRecorder, with reasons to decide by."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class LabRecorderReason(Enum):
    """Why a recording was not started, or not stopped as it should be."""

    UNREACHABLE = "unreachable"
    """Nothing listens there, or it went away."""
    NO_REPLY = "no_reply"
    """Something listens and does not answer: a message in its window waits for a click."""
    REFUSED = "refused"
    """It answers something else than ``OK``."""
    RECORDING = "recording"
    """It is recording already."""
    EXISTS = "exists"
    """The file is there already."""
    STREAMS_MISSING = "streams_missing"
    FOREIGN_STREAMS = "foreign_streams"
    NO_GROWTH = "no_growth"
    """The file does not come, or does not grow."""
    STILL_GROWING = "still_growing"
    NOT_CLOSED = "not_closed"
    """The file does not grow, but was not closed either."""


class LabRecorderError(GatewayError):
    """A recording was not started, or not stopped as it should be."""


class SensorsAwayError(GatewayError):
    """Nobody has confirmed that a recording is to begin without sensors that do not stream.

    Attributes
    ----------
    sentences
        One for each sensor, without a full stop.
    """

    def __init__(self, sentences: Sequence[str]) -> None:
        message = (
            f"{'; '.join(sentences)}. Wait for that with: biosensor-gateway wait-ready, or record "
            "without it with --allow-missing"
        )
        super().__init__(LabRecorderReason.STREAMS_MISSING, message)
        self.sentences = tuple(sentences)
