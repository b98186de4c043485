"""Says of a recording that goes on what the agent knows of it: which sensors are away."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from biosensor_gateway.agent.absences import Absence, absences, names
from biosensor_gateway.agent.state import is_sending
from biosensor_gateway.recording.xdf.findings import Finding, Level

Devices = Sequence[Mapping[str, Any]]
"""The devices of the agent, as its status has them; None in their place if no agent runs."""


def excused(devices: Devices | None, started: float) -> frozenset[str]:
    """Return the source_ids that may say nothing: switched off, or of a sensor known to be away.

    Parameters
    ----------
    started
        Unix time in s at which the recording began.
    """
    away = (each.sources for each in absences(devices or ()) if _is_known(each, started))
    silent = (
        source
        for device in devices or ()
        for source, stream in device["streams"].items()
        if stream["silent"]
    )
    return frozenset(silent).union(*away)


def findings(
    devices: Devices | None, recorded: Collection[str], started: float
) -> Iterator[Finding]:
    """Name the sensors of which nothing is recorded now.

    Parameters
    ----------
    recorded
        The source_ids that the file has; empty while nobody knows them.
    started
        Unix time in s at which the recording began.
    """
    if devices is None:
        text = "the agent does not run, so nothing of its sensors is recorded"
        yield Finding(Level.ERROR, "no-agent", "", text)
        return
    for each in absences(devices):
        level = Level.WARNING if _is_known(each, started) else Level.ERROR
        yield Finding(level, "away", "", each.sentence)
    for device, name in zip(devices, names(devices, "'s "), strict=True):
        sources = device["streams"].keys()
        sends = sources and is_sending(device["state"], paused=device["paused"])
        if sends and recorded and not sources & set(recorded):
            text = (
                f"{name} streams, and is not in the file: it was not there under this name when "
                "the recording began; stop it and record anew"
            )
            yield Finding(Level.ERROR, "left-out", "", text)


def _is_known(absence: Absence, started: float) -> bool:
    """Whether a person has wanted it: paused it, or begun to record without it."""
    was_before = absence.since is not None and absence.since <= started
    return absence.is_paused or absence.is_partial or was_before
