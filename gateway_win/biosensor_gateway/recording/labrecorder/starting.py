"""Starts a recording, and checks that it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from biosensor_gateway.recording.labrecorder.errors import (
    LabRecorderError,
    LabRecorderReason,
    SensorsAwayError,
)
from biosensor_gateway.recording.labrecorder.memory import Remembered, recall, remember
from biosensor_gateway.recording.labrecorder.recording_file import (
    glance,
    grows,
    size_of,
    sizes,
    wait_for_growth,
)
from biosensor_gateway.recording.participants import (
    OtherParticipantsError,
    compare,
    participant_of,
)
from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.request import Place, Target, choose_target
from biosensor_gateway.recording.recorder.result import By, Started
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream, titles
from biosensor_gateway.system.cloud_folders import warnings_of

GROWTH_S = 30.0
STILL_RECORDS_S = 10.0
"""A recording of one agent writes a block in less."""


@dataclass(frozen=True, slots=True)
class Order:
    """What to record, and what to do about what is not as it should be.

    Attributes
    ----------
    place
        Where to.
    all_streams
        Streams of others are meant to be recorded, too.
    only_ours
        Refuse if there are streams of others.
    allow_missing
        Start although streams are missing.
    without_away
        Start although sensors of the agent do not stream.
    other_participants
        Start although the file is called after somebody else than who wears the sensors.
    growth_s
        How long the file may take to grow.
    """

    place: Place
    all_streams: bool = False
    only_ours: bool = False
    allow_missing: bool = False
    growth_s: float = GROWTH_S
    other_participants: bool = False
    without_away: bool = False

    @property
    def participant(self) -> str:
        """Whose recording the file will say it is; empty if it says nobody."""
        if self.place.labels is not None:
            return self.place.labels.participant
        return "" if self.place.file is None else participant_of(self.place.file)


def start(
    remote: RemoteControl, order: Order, look: Callable[[], Presence], state: Path
) -> Started:
    """Start a recording.

    Parameters
    ----------
    remote
        Connected.
    order
        What to record.
    look
        Looks for the streams there are.
    state
        Folder that keeps what `record stop` and `status` need to know.

    Raises
    ------
    LabRecorderError
        With the reason why nothing was started, or why nobody can say that it was.
    ConfigError
        If `order` makes no sense.
    """
    target = choose_target(order.place, is_local=remote.is_local)
    _require_idle(remote, state)
    _require_free(target)
    presence = look()
    require_sensors(presence, order)
    _require_streams(presence, order)
    require_participant(presence, order)
    warnings = [*_warnings(presence, order)]
    before, begun = sizes(target), time.monotonic()
    for command in ("update", "select all", target.command, "start"):
        if command:
            remote.command(command)
    file = target.files[0] if target.files else None
    kept = Remembered(remote.host, remote.port, str(file or ""), time.time())
    problem = remember(state, kept)
    took_s = 0.0
    if target.folder is None:
        file = None
        warnings.append(_unverified(remote))
    else:
        file = _require_growth(target, before, order.growth_s)
        took_s = time.monotonic() - begun
        # Only now its name is certain.
        problem = remember(state, replace(kept, file=str(file)))
    warnings += [problem] if problem else []
    warnings += warnings_of(file.parent) if file is not None else ()
    return Started(
        by=By.WINDOW,
        verified=file is not None,
        file=file,
        bytes=0 if file is None else size_of(file) or 0,
        took_s=took_s,
        streams=presence.visible,
        foreign=presence.foreign,
        warnings=tuple(warnings),
    )


def _require_idle(remote: RemoteControl, state: Path) -> None:
    last = recall(state, remote.host, remote.port)
    if last is None or not last.file:
        return
    file = Path(last.file)
    if not glance(file).is_closed and grows(file, STILL_RECORDS_S):
        message = (
            f"LabRecorder is recording already, to {file}; end that with: "
            "biosensor-gateway record stop"
        )
        raise LabRecorderError(LabRecorderReason.RECORDING, message)


def _require_free(target: Target) -> None:
    for file in target.files:
        if file.exists():
            message = (
                f"{file} is there already, and LabRecorder would rename it; choose another name "
                "or run"
            )
            raise LabRecorderError(LabRecorderReason.EXISTS, message)


def what_is_missing(
    presence: Presence, wanted: tuple[VisibleStream, ...], order: Order
) -> str | None:
    """Say why nothing can be recorded of what there is; None if it can.

    Parameters
    ----------
    presence
        The streams there are.
    wanted
        Those of them that are to be recorded.
    """
    if not wanted:
        whose = "of this agent " if presence.visible else ""
        return (
            f"this computer sees no LSL stream {whose}at all, so there is nothing to record; "
            "start an agent with: biosensor-gateway run"
        )
    if presence.missing and not order.allow_missing:
        return (
            f"streams are missing, and what is not there at the start is not recorded: "
            f"{'; '.join(presence.missing)}. Wait for them with: biosensor-gateway wait-ready, or "
            "do without with --allow-missing"
        )
    return None


def require_participant(presence: Presence, order: Order) -> None:
    """Refuse a file that is called after somebody else than who wears the sensors.

    Raises
    ------
    OtherParticipantsError
        Unless `order` confirms it.
    """
    mismatch = compare(order.participant, presence.worn)
    if mismatch is not None and not order.other_participants:
        raise OtherParticipantsError(mismatch)


def require_sensors(presence: Presence, order: Order) -> None:
    """Refuse while a sensor of the agent is paused or does not stream.

    Raises
    ------
    SensorsAwayError
        Unless `order` confirms it.
    """
    if presence.away and not order.without_away:
        raise SensorsAwayError(presence.away)


def _require_streams(presence: Presence, order: Order) -> None:
    message = what_is_missing(presence, presence.visible, order)
    if message is not None:
        raise LabRecorderError(LabRecorderReason.STREAMS_MISSING, message)
    if presence.foreign and order.only_ours:
        message = (
            "LabRecorder records every stream that it sees, and these are not of this agent: "
            f"{titles(presence.foreign)}; end them, or leave out --only-ours"
        )
        raise LabRecorderError(LabRecorderReason.FOREIGN_STREAMS, message)


def recorded_without(what: Sequence[str]) -> Iterator[str]:
    """Name what is missing in a recording that begins all the same."""
    if what:
        yield f"recorded without: {'; '.join(what)}"


def _warnings(presence: Presence, order: Order) -> Iterator[str]:
    yield from recorded_without((*presence.away, *presence.missing))
    if presence.foreign and not order.all_streams:
        yield (
            "started by remote control, LabRecorder records every stream that it sees; these are "
            f"not of this agent: {titles(presence.foreign)}"
        )


def _unverified(remote: RemoteControl) -> str:
    return (
        f"LabRecorder runs on another computer ({remote.host}), and its answer says nothing: look "
        "at its window whether it records, or give --folder, a folder that both computers see"
    )


def _require_growth(target: Target, before: Mapping[Path, int], limit_s: float) -> Path:
    file = wait_for_growth(target, before, limit_s)
    if file is None:
        raise LabRecorderError(LabRecorderReason.NO_GROWTH, _no_growth(target, limit_s))
    return file


def _no_growth(target: Target, limit_s: float) -> str:
    where = target.files[0] if target.files else f"a recording in {target.folder}"
    found = any(sizes(target)) if target.files else False
    what = "is there, but no samples were written to it" if found else "did not appear and grow"
    return (
        f"{where} {what} within {limit_s:g} s, whatever LabRecorder answers. It may be recording "
        "something else already, may not be allowed to write there, or see no streams: look at "
        "its window. Slow streams need longer: --timeout"
    )
