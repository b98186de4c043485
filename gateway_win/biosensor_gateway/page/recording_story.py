"""Keeps what has happened in a recording that goes on, when it is over already."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from biosensor_gateway.agent.absences import Absence, absences, clock_time
from biosensor_gateway.recording.here.results import StandingHere, StartedHere
from biosensor_gateway.recording.labrecorder.streams import titles

_MOST = 20
"""Of a sensor that comes and goes, the newest are enough."""


class Story:
    """What there is to say of one recording besides how it stands now.

    Parameters
    ----------
    begun
        How it began, if that was here.

    Attributes
    ----------
    remarks
        What is good to know, and nothing is wrong with it.
    """

    def __init__(self, begun: StartedHere | None = None) -> None:
        self._file = begun.file if begun else None
        self._started: float | None = None
        self._warnings = [] if begun is None else [*begun.left_out]
        self._away: dict[str, Absence] = {}
        self._over: list[str] = []
        self.remarks: list[str] = []
        if begun and begun.foreign:
            self.remarks = [f"streams of other programs are recorded, too: {titles(begun.foreign)}"]

    @property
    def notes(self) -> list[str]:
        """What is not as it should be, or was not for a while."""
        return [*self._warnings, *self._over]

    def is_of(self, standing: StandingHere) -> bool:
        """Whether it is that of this recording."""
        if self._started is None:
            return self._file in (None, standing.file)
        return (self._file, self._started) == (standing.file, standing.started)

    def look(self, devices: Sequence[Mapping[str, Any]], standing: StandingHere) -> None:
        """Note which sensors are away, and which have come back since the last look."""
        self._file, self._started = standing.file, standing.started
        now = {each.device: each for each in absences(devices)}
        here = {f"{each['sensor']}/{each['unit']}" for each in devices}
        for device, before in self._away.items():
            if device in here and device not in now:
                self._over = [*self._over[1 - _MOST :], _was_away(before, time.time())]
        # While the agent is away, nobody knows of its sensors.
        kept = {device: each for device, each in self._away.items() if device not in here}
        self._away = kept | now


def _was_away(absence: Absence, until: float) -> str:
    how = "was paused" if absence.is_paused else "did not send all that it should"
    if not absence.is_paused and absence.sources:
        how = "did not send"
    since = "" if absence.since is None else f"from {clock_time(absence.since, seconds=True)} "
    return f"{absence.name} {how} {since}until {clock_time(until, seconds=True)}"
