"""Tells of a recording of this computer itself, of which everything can be known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.recorder.result import Standing, Started, Stopped
from biosensor_gateway.recording.xdf.verdict import Verdict


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
