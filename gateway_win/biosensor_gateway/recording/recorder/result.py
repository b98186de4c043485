"""Results of a recorder, and its errors with reasons to decide by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum, unique
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_common.errors import GatewayError
from biosensor_gateway.recording.recorder.live_file import Sight
from biosensor_gateway.recording.recorder.streams import VisibleStream
from biosensor_gateway.recording.xdf.findings import Finding
from biosensor_gateway.recording.xdf.verdict import Verdict

if TYPE_CHECKING:
    from biosensor_gateway.recording.xdf.verdict import Verdict


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


@unique
class By(StrEnum):
    """Who makes a recording."""

    WINDOW = "window"
    """LabRecorder's window, which cannot be asked."""
    GATEWAY = "gateway"
    """This computer by itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Started:
    """A recording that was started.

    Attributes
    ----------
    verified
        Whether its file was seen to grow.
    file
        None if it cannot be reached from this computer; then nothing is verified.
    bytes
        Its size then.
    took_s
        From the command until then.
    streams
        What is recorded, as far as it is seen from here.
    foreign
        Those of them that are not of this agent.
    warnings
        Sentences.
    left_out
        Those of them that name what is not recorded until its end.
    """

    by: By
    verified: bool
    file: Path | None
    bytes: int
    took_s: float
    streams: tuple[VisibleStream, ...]
    foreign: tuple[VisibleStream, ...]
    warnings: tuple[str, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """How a recording stands.

    Attributes
    ----------
    recording
        Whether it goes on; None if that cannot be known.
    file
        None if it is not known.
    started
        Unix time in s; None if it is not known.
    bytes, streams, with_samples
        Size of the file, number of streams in it, and of those that hold samples.
    is_closed
        Whether every stream in it was ended.
    is_local
        Whether it is made on this computer; None if that is not known.
    answers
        Whether who makes it can be reached.
    required
        source_ids of the streams that it must have.
    sight
        What is in the file so far; None if it was not read so closely, or cannot be.
    problems
        What is wrong, the worst first.
    """

    by: By
    recording: bool | None
    file: Path | None
    started: float | None
    bytes: int = 0
    streams: int = 0
    with_samples: int = 0
    is_closed: bool = False
    is_local: bool | None = True
    answers: bool = True
    required: tuple[str, ...] = ()
    sight: Sight | None = None
    problems: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """A recording that was ended.

    Attributes
    ----------
    verified
        Whether its file was found closed.
    file
        None if it is not known, or not within reach; then nothing is verified.
    streams, with_samples
        Number of streams in the file, and of those that hold samples.
    took_s
        From the command until the file was found closed.
    verdict
        Whether it can be trusted; None if it was not read so closely.
    warnings
        Sentences.
    """

    by: By
    verified: bool
    file: Path | None
    bytes: int = 0
    streams: int = 0
    with_samples: int = 0
    took_s: float = 0.0
    verdict: Verdict | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StartedHere(Started):
    """A recording of this computer itself that was started."""

    file: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class StandingHere(Standing):
    """How a recording of this computer itself stands."""

    recording: bool
    file: Path
    started: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedHere(Stopped):
    """A recording of this computer itself that was ended."""

    file: Path
    verdict: Verdict
