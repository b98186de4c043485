"""Results of a recorder: how a recording was started, stands, and was ended.

Whoever records, the fields are the same, so that a script reads either. Of a recording that this
computer makes by itself everything can be known, which the types of the ``Local`` ones say.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, unique
from pathlib import Path

from biosensor_gateway.recording.recorder.live_file import Progress
from biosensor_gateway.recording.recorder.streams import VisibleStream
from biosensor_gateway.recording.xdf.findings import Finding
from biosensor_gateway.recording.xdf.verdict import Verdict


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
    bytes, took_s
        Its size then, and the time from the command until then.
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
class LocalStarted(Started):
    """A recording of this computer itself that was started."""

    file: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
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
    sight: Progress | None = None
    problems: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalStatus(Status):
    """How a recording of this computer itself stands."""

    recording: bool
    file: Path
    started: float


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
class LocalStopped(Stopped):
    """A recording of this computer itself that was ended."""

    file: Path
    verdict: Verdict
