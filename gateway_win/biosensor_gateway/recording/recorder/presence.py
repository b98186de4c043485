"""Lists the streams in the network, and those that a recording would miss."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.device_states import Absence, absences, identity_of, is_sending, names
from biosensor_gateway.devices.registry import declaration, declared
from biosensor_gateway.recording.participants import OtherParticipantsError, Worn, compare
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
    SensorsAwayError,
    VisibleStream,
)
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.streaming.counters import GATEWAY

SEARCH_S = 2.0
"""Answers come in waves; LabRecorder itself searches for one second."""
SEARCH_LIMIT_S = 8.0
"""Limit for expected streams."""
_MOST_NAMED = 20

Devices = Sequence[Mapping[str, Any]]
"""The devices in the agent's status; None instead if no agent runs."""


@dataclass(frozen=True, slots=True)
class ExpectedDevice:
    """A device whose streams should be recorded."""

    title: str
    why: str  # Its state according to the agent, if it does not stream.
    source_ids: frozenset[str]
    worn: Worn
    # Why and since when it does not stream, according to the agent; empty if it streams.
    away: str = ""


@dataclass(frozen=True, slots=True)
class Presence:
    """The visible streams, compared with the expected ones."""

    visible: tuple[VisibleStream, ...]
    # Streams of other programs, or of agents on other computers.
    foreign: tuple[VisibleStream, ...]
    missing: tuple[str, ...]  # One clause per device with expected streams that are not visible.
    worn: tuple[Worn, ...] = ()  # Participants of the devices with visible streams.
    # One clause per device that does not stream, according to the agent.
    away: tuple[str, ...] = ()
    away_ids: frozenset[str] = frozenset()


def live_features(
    recorded: Sequence[VisibleStream], foreign: Sequence[VisibleStream]
) -> list[VisibleStream]:
    """Return the recorded streams of others that are features of the agent's sensors."""

    def of_sensor(stream: VisibleStream) -> str:
        return stream.source_id.rpartition("-")[0] or stream.source_id

    own = {of_sensor(each) for each in recorded if each not in foreign}
    return [each for each in foreign if of_sensor(each) in own]


def expected_devices(settings: GatewaySettings, state: Path) -> tuple[ExpectedDevice, ...]:
    """Return the devices of the running agent, or without an agent those of the settings.

    Raises
    ------
    SpecError
        If a sensor's declaration cannot be loaded.
    RecorderError
        ``OTHER_SESSION``: the settings have changed since the agent began.
    """
    try:
        status = status_file.read_status(state)
    except ConfigError as error:
        if error.reason is not ConfigReason.NOT_FOUND:
            raise
        enabled = [device for device in settings.devices if device.enabled]
        return tuple(
            _expected(
                each.identity,
                [stream.data_name for stream in declared(each).streams],
                "no agent is running here",
            )
            for each in enabled
        )
    other = status_file.other_session(status, settings.lsl.overrides)
    if other:
        # In another session streams of equal source_ids are other people's.
        message = (
            f"{other}; start the agent again, set session_id in [lsl] back, or name the agent's"
            " settings file with --settings"
        )
        raise RecorderError(RecorderReason.OTHER_SESSION, message)
    away = {e.device: e.sentence for e in absences(status["devices"]) if not e.is_partial}
    return tuple(_of_status(device, away) for device in status["devices"])


def _of_status(device: Mapping[str, Any], away: Mapping[DeviceIdentity, str]) -> ExpectedDevice:
    identity = identity_of(device)
    why = " - ".join(part for part in (device["state"], device["error"]) if part)
    own = [each["data_name"] for each in device.get("declared", ())]
    # Streams that the settings declare, else those of the sensor's kind.
    streams = own or [each.data_name for each in declaration(device["sensor"]).streams]
    expected = _expected(identity, streams, why)
    return replace(expected, away=away.get(identity, ""))


def _expected(identity: DeviceIdentity, data_names: Iterable[str], why: str) -> ExpectedDevice:
    parts = (identity.participant, identity.sensor, identity.label)
    title = " ".join(part for part in parts if part) + f" ({identity.unit})"
    ids = frozenset(naming.source_id(identity, each) for each in data_names)
    return ExpectedDevice(title, why, ids, Worn.by(identity))


def look(settings: GatewaySettings, state: Path) -> Presence:
    """Search for streams until all expected ones are found, for at least two seconds.

    Parameters
    ----------
    settings
        Its LSL section configures this process, unless that was done before.
    state
        State folder of the agent whose streams count as ours.

    Raises
    ------
    RecorderError
        As of `expected_devices`.
    """
    from biosensor_common.lsl.network import configure_lsl  # noqa: PLC0415 - as pylsl

    expected = expected_devices(settings, state)
    configure_lsl(settings.lsl.overrides)
    there = [device for device in expected if not device.away]
    needed = frozenset[str]().union(*(device.source_ids for device in expected))
    seen = _search(frozenset[str]().union(*(device.source_ids for device in there)))
    ours = needed | {_own(each.data_name) for each in GATEWAY.streams}
    present = {each.source_id for each in seen}
    return Presence(
        visible=seen,
        foreign=tuple(each for each in seen if each.source_id not in ours),
        missing=tuple(_missing(device, present) for device in there
                      if not device.source_ids <= present),
        worn=tuple(device.worn for device in expected if device.source_ids & present),
        away=tuple(device.away for device in expected if device.away),
        away_ids=frozenset[str]().union(*(e.source_ids for e in expected if e.away)),
    )  # fmt: skip


def own_events() -> str:
    """Return the source_id of the events of the agent on this computer."""
    return _own("events")


def _own(data_name: str) -> str:
    return naming.source_id(DeviceIdentity(naming.AGENT, socket.gethostname()), data_name)


def _search(needed: frozenset[str]) -> tuple[VisibleStream, ...]:
    # Imported here, because help and past recordings do not need the library.
    from biosensor_common.lsl.network import Streams, search  # noqa: PLC0415

    def is_enough(found: Streams, elapsed_s: float) -> bool:
        is_complete = needed <= {info.source_id() for info in found.values()}
        return elapsed_s >= (SEARCH_S if is_complete else SEARCH_LIMIT_S)

    found = search(is_enough)
    return tuple(
        sorted(VisibleStream(info.name(), info.source_id(), info.hostname()) for info in found)
    )


def _missing(device: ExpectedDevice, present: set[str]) -> str:
    gone = len(device.source_ids - present)
    count = "none" if gone == len(device.source_ids) else f"only {len(device.source_ids) - gone}"
    why = f": {device.why}" if device.why else ""
    return f"{device.title}, {count} of its {len(device.source_ids)} streams{why}"


def titles(streams: Iterable[VisibleStream], most: int = _MOST_NAMED) -> str:
    """Return the titles of streams, or of the first ones if there are many."""
    named = [stream.title for stream in streams]
    more = len(named) - most
    return ", ".join(named[:most]) + (f" and {more} more" if more > 0 else "")


def require_startable(
    presence: Presence, wanted: Sequence[VisibleStream], request: RecordingRequest
) -> None:
    """Raise an error if something is wrong that the request does not confirm.

    Raises
    ------
    SensorsAwayError
        If a sensor of the agent is paused or does not stream.
    RecorderError
        ``STREAMS_MISSING``.
    OtherParticipantsError
        If the file's name has another participant than the sensors.
    """
    if presence.away and not request.without_away:
        raise SensorsAwayError(presence.away)
    if not wanted:
        whose = " of this agent" if presence.visible else ""
        message = (
            f"this computer sees no LSL stream{whose}, so there is nothing to record; start an "
            "agent with: biosensor-gateway run"
        )
        raise RecorderError(RecorderReason.STREAMS_MISSING, message)
    if presence.missing and not request.allow_missing:
        message = (
            "streams are missing, and streams that are absent at the start are not recorded: "
            f"{'; '.join(presence.missing)}. Wait for them with: biosensor-gateway wait-ready, "
            "or record without them using --allow-missing"
        )
        raise RecorderError(RecorderReason.STREAMS_MISSING, message)
    mismatch = compare(request.participant, presence.worn)
    if mismatch is not None and not request.other_participants:
        raise OtherParticipantsError(mismatch)


def recorded_without(what: Sequence[str]) -> Iterator[str]:
    """Yield a sentence about the missing parts of a recording that starts anyway."""
    if what:
        yield f"recorded without: {'; '.join(what)}"


def doubles(presence: Presence, wanted: Sequence[VisibleStream]) -> Iterator[str]:
    """Yield sentences if streams of the agent, or names of recorded streams, are there twice."""
    ours = Counter(each for each in presence.visible if each not in presence.foreign)
    twice = [each for each, count in ours.items() if count > 1 and each.source_id]
    if twice:
        yield (
            f"{titles(twice)} exist twice each: another agent uses the same names, and its data "
            "may be another person's; end it, or give its sensors another participant, and "
            "record again"
        )
    names = Counter(each.name for each in wanted)
    alike = [each for each in wanted if names[each.name] > 1 and each not in twice]
    if alike:
        yield (
            f"{titles(alike)} have the same name: only numbers tell them apart in exports; end "
            "what is not wanted, or give each its own name, and record again"
        )


def excused(devices: Devices) -> frozenset[str]:
    """Return the source_ids that may be silent: switched off, or of a sensor known to be away."""
    away = (each.sources for each in absences(devices))
    silent = (
        source
        for device in devices
        for source, stream in device["streams"].items()
        if stream["silent"]
    )
    return frozenset(silent).union(*away)


def away_findings(
    devices: Devices | None,
    recorded: Collection[str],
    started: float,
    without: Collection[str] = (),
) -> Iterator[Finding]:
    """Yield findings about sensors that are not being recorded now.

    Parameters
    ----------
    recorded
        The source_ids in the file; empty while unknown.
    started
        Start of the recording in Unix time.
    without
        The source_ids of sensors that were away at the start, as the user knew.
    """
    if devices is None:
        text = "the agent is not running, so none of its sensors' data is recorded"
        yield Finding(Level.ERROR, "no-agent", "", text)
        return  # nothing is dropped: that no agent runs is told
    for each in absences(devices):
        level = Level.WARNING if _is_known(each, started, without) else Level.ERROR
        yield Finding(level, "away", "", each.sentence)
    for device, name in zip(devices, names(devices, "'s "), strict=True):
        sources = device["streams"].keys()
        sends = sources and is_sending(device["state"], paused=device["paused"])
        if sends and recorded and not sources & set(recorded):
            text = (
                f"{name} is streaming, but is not in the file: it did not exist under this name "
                "when the recording started; stop it and record again"
            )
            yield Finding(Level.ERROR, "left-out", "", text)


def _is_known(absence: Absence, started: float, without: Collection[str]) -> bool:
    """Whether the user knows: paused the sensor, or started recording without it.

    A sensor that left while the streams were being opened was still present at the question.
    """
    if absence.is_paused or absence.is_partial:
        return True
    was_before = absence.since is not None and absence.since <= started
    return was_before and absence.sources <= frozenset(without)
