"""Results of a recorder: start, status and stop of a recording.

The fields are the same for both recorders, so that a script can read either. In the ``Local``
classes, fields that are always known have narrower types.
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
    """This computer's own recorder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Started:
    """A recording that was started.

    Attributes
    ----------
    verified
        Whether its file was found growing.
    file
        None if this computer cannot access it; then nothing is verified.
    bytes, took_s
        Size of the file when found growing, and the time from the command until then.
    streams
        Recorded streams, as visible from this computer.
    foreign
        Streams of other programs or agents.
    left_out
        The warnings about sensors that are not recorded at all.
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
    """A recording on this computer that was started."""

    file: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The status of a recording.

    Attributes
    ----------
    recording
        Whether it is running; None if unknown.
    file
        None if unknown.
    started
        Unix time in s; None if unknown.
    is_closed
        Whether every stream has a footer.
    is_local
        Whether it is made on this computer; None if unknown.
    required
        source_ids of the streams that it must contain.
    sight
        Contents of the file so far; None if it was not or cannot be read.
    problems
        Problems, the worst first.
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
    """The status of a recording on this computer."""

    recording: bool
    file: Path
    started: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """A recording that was stopped.

    Attributes
    ----------
    verified
        Whether its file was found closed.
    file
        None if unknown or not accessible; then nothing is verified.
    took_s
        Time from the command until the file was found closed.
    verdict
        Result of the check; None if it was not checked.
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
    """A recording on this computer that was stopped."""

    file: Path
    verdict: Verdict
