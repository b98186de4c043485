"""Changes the devices of the settings, applies them to the agent, and shows devices' logs."""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_common.naming import require_participant
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control
from biosensor_gateway.agent.device_states import described, device_name
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.devices.registry import sensor_title, settings_models
from biosensor_gateway.page.models import (
    Body,
    Choice,
    Outcome,
)
from biosensor_gateway.page.routes.api import QuestionError
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.recorder.state import file_going_on
from biosensor_gateway.settings import editor
from biosensor_gateway.settings.models import ShortText, UnitText
from biosensor_gateway.settings.places import SETTINGS_VARIABLE
from biosensor_gateway.system.child import start_beside
from biosensor_gateway.system.console_lines import on_one_line, sentence_of
from biosensor_gateway.system.logs import LOG_FILE_NAME


class SettingsChange(Body):
    """A change of the settings.

    Attributes
    ----------
    while_recording
        Whether to make the change during a recording.
    """

    while_recording: bool = False


class NewDevice(SettingsChange):
    """A device to add to the settings."""

    sensor: str
    settings: dict[str, str | int | float | bool]
    participant: ShortText = ""
    label: ShortText = ""


class DeviceName(Body):
    """Identifies a device."""

    sensor: str
    unit: UnitText


class WornDevice(DeviceName):
    """Identifies a device, also where several people wear a virtual one of its kind."""

    participant: ShortText = ""
    label: ShortText = ""


class DeviceRemoval(SettingsChange, DeviceName):
    """A device to remove from the settings."""


class DeviceChange(SettingsChange, DeviceName):
    """New values for a device of the settings; None leaves a value unchanged."""

    participant: ShortText | None = None
    label: ShortText | None = None
    enabled: bool | None = None


class ParticipantNow(SettingsChange):
    """The participant to set for all sensors of the settings."""

    participant: str


def _add_pauses(router: APIRouter, session: Session) -> None:
    @router.post("/devices/pause")
    async def pause(device: WornDevice) -> Outcome:
        """Pause a device: nothing of it is sent until it is resumed."""
        return await _switched(session, "pause", device)

    @router.post("/devices/resume")
    async def resume(device: WornDevice) -> Outcome:
        """Resume a paused device."""
        return await _switched(session, "resume", device)


async def _switched(session: Session, command: str, device: WornDevice) -> Outcome:
    identity = DeviceIdentity(device.sensor, device.unit, device.participant, device.label)
    name = device_name(identity)
    # Who wears it only if needed: it may have just been changed, and a withdrawal must not fail.
    alike = [e for e in session.device_facts() or () if f"{e['sensor']}/{e['unit']}" == name]
    answer = await asked(session, command, {"device": described(identity) if alike[1:] else name})
    problem = answer.get("problem")
    if problem and not answer.get("pending"):
        # The running agent has done it; only an agent that is started later would not know.
        return Outcome(sentence=f"Done, but not saved for the next start: {problem}.")
    return Outcome(sentence=f"The device is {command}d.")


BACK_WITHIN_S = 30.0
"""How long to wait for renamed sensors to stream again; Bluetooth takes some seconds."""
_POLL_S = 0.1
ALL_VIRTUAL = "all"


def add_devices(router: APIRouter, session: Session) -> None:
    """Add the routes that add, change and remove devices, and set who wears them."""

    @router.post("/devices")
    async def add(device: NewDevice) -> Outcome:
        """Add a device to the settings, and have the agent stream it."""
        if device.participant:
            require_participant(device.participant)
        _ask_while_recording(session, device, "A sensor that is added now will not be in it.")
        worn = {"participant": device.participant, "label": device.label}
        fields = {**device.settings, **{key: value for key, value in worn.items() if value}}
        models = settings_models()
        editor.add_device(session.settings, models, device.sensor, fields)
        whose = f"{device.participant}'s " if device.participant else "The "
        name = f"{whose}{sensor_title(device.sensor)}"
        return await _applied(session, f"{name} was added: its card appears when it streams")

    @router.patch("/devices")
    async def change(device: DeviceChange) -> Outcome:
        """Change a device of the settings; it is restarted, and the others go on streaming."""
        fields = _changed(session, device)
        if fields.get("participant"):
            require_participant(str(fields["participant"]))
        if fields:
            lost = "The sensor gets new streams, and from then on none of its data is in the file."
            _ask_while_recording(session, device, lost)
        # An empty value is the default, so that its key is removed.
        wanted = {key: None if value == "" else value for key, value in fields.items()}
        models = settings_models()
        editor.change_device(session.settings, models, device.sensor, device.unit, wanted)
        return await _applied(session, "The device was changed in the settings")

    @router.delete("/devices")
    async def remove(device: DeviceRemoval) -> Outcome:
        """Remove a device from the settings; its streams end, and the others go on."""
        _ask_while_recording(
            session, device, "From then on, none of the sensor's data is in the file."
        )
        models = settings_models()
        editor.remove_device(session.settings, models, device.sensor, device.unit)
        return await _applied(session, "The device was removed from the settings")

    @router.get("/devices/log")
    async def device_log(sensor: str, unit: str, participant: str = "", label: str = "") -> LogView:
        """Return the newest lines of the log about a device."""
        identity = DeviceIdentity(sensor, unit, participant, label)
        return await asyncio.to_thread(last_lines, session.folder, identity)

    _add_pauses(router, session)
    _add_participant(router, session)


def _add_participant(router: APIRouter, session: Session) -> None:
    @router.put("/participant")
    async def set_participant(wanted: ParticipantNow) -> Outcome:
        """Set the participant of all sensors of the settings; wait until they stream again."""
        lost = "All sensors get new streams, and from then on none of their data is in the file."
        _ask_while_recording(session, wanted, lost)
        waited_for = await worn_by(session, wanted.participant)
        if waited_for:
            return Outcome(
                sentence=f"All sensors are set to {wanted.participant}; not streaming yet: "
                f"{', '.join(waited_for)}."
            )
        return Outcome(sentence=f"All sensors are worn by {wanted.participant} now.")


async def worn_by(session: Session, participant: str) -> list[str]:
    """Set the participant of all sensors of the settings, and wait until they stream again.

    Returns
    -------
    list of str
        Sensors that streamed before and do not after `BACK_WITHIN_S`, as ``sensor/unit``.

    Raises
    ------
    ConfigError
        If the name or the settings do not allow it.
    """
    require_participant(participant)
    if session.is_virtual:
        message = "virtual sensors are not in the settings; name who wears them with --simulate"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    before = session.streaming()
    editor.set_participant(session.settings, settings_models(), participant)
    if not is_held(session.folder):
        return []
    await asked(session, "reload", {})
    deadline = time.monotonic() + BACK_WITHIN_S
    while missing := before - _streaming_for(session, participant):
        if time.monotonic() > deadline:
            break
        await asyncio.sleep(_POLL_S)
    return ["/".join(each) for each in sorted(missing)]


def _streaming_for(session: Session, participant: str) -> frozenset[tuple[str, str]]:
    own = {each.sensor for each in session.worn() if each.participant == participant}
    return frozenset(each for each in session.streaming() if "/".join(each) in own)


def _changed(session: Session, wanted: DeviceChange) -> dict[str, str | bool]:
    """Return the fields that differ from the settings."""
    which = wanted.sensor, wanted.unit
    found = [each for each in session.configured() if (each.sensor, each.unit) == which]
    fields = wanted.model_dump(include={"participant", "label", "enabled"}, exclude_none=True)
    if not found:
        return fields
    return {key: value for key, value in fields.items() if getattr(found[0], key) != value}


def _ask_while_recording(session: Session, change: SettingsChange, lost: str) -> None:
    """Ask for confirmation of a change during a recording.

    Raises
    ------
    QuestionError
        If a recording is running and the change is not confirmed.
    """
    file = file_going_on(session.folder)
    if file is not None and not change.while_recording:
        again = Choice(words="Change it anyway", more={"while_recording": True})
        raise QuestionError("A recording is running", f"The file is {file}. {lost}", [again])


def started(session: Session, *, virtual: bool) -> Outcome:
    """Start the agent."""
    start_agent(session.folder, session.settings, virtual=virtual)
    session.note_start()
    return Outcome(sentence="The agent is starting.")


async def _applied(session: Session, what: str) -> Outcome:
    """Apply the settings to the agent, or start it if none runs."""
    if is_held(session.folder):
        await asked(session, "reload", {})
    elif any(each.enabled for each in session.configured()):
        started(session, virtual=False)
    return Outcome(sentence=f"{what}.")


async def asked(session: Session, command: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Send a command to the agent, and return its answer."""
    return await asyncio.to_thread(control.ask, session.folder, command, arguments)


def start_agent(folder: Path, settings: Path, *, virtual: bool) -> None:
    """Start an agent with a supervisor that restarts it after a crash.

    Raises
    ------
    TransportError
        ``BUSY`` if one runs already; ``ABSENT`` if the system cannot start it.
    """
    if is_held(folder):
        raise TransportError(TransportReason.BUSY, "an agent is already running; end it first")
    what = ["--simulate", ALL_VIRTUAL] if virtual else ["--settings", str(settings)]
    try:
        # By a variable for virtual devices, because a file that an option names must exist.
        start_beside(["run", "--keep-alive", "--no-ask", *what], {SETTINGS_VARIABLE: str(settings)})
    except OSError as error:
        message = f"the agent could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error


MOST_LINES = 20
MOST_BYTES = 256 * 1024
"""Number of bytes that are read from the end of a file."""
_MOST_LETTERS = 400
# The previous file as well, because a new one begins empty.
_FILES = (LOG_FILE_NAME, f"{LOG_FILE_NAME}.1")


class LogLine(BaseModel):
    """One line of the log.

    Attributes
    ----------
    time
        ISO 8601 in UTC.
    level
        ``debug``, ``info``, ``warning``, ``error`` or ``critical``.
    sentence
        What happened, with its facts; at most 400 letters.
    """

    time: str
    level: str
    sentence: str


class LogView(BaseModel):
    """The newest lines of the log about a device, the newest first; empty without a log."""

    lines: list[LogLine] = Field(default_factory=list[LogLine])


def last_lines(folder: Path, identity: DeviceIdentity) -> LogView:
    """Return the newest lines about a device, at most `MOST_LINES`.

    Parameters
    ----------
    identity
        Of the device; who wears it matters for virtual ones alone.
    """
    lines: list[LogLine] = []
    for name in _FILES:
        for record in _newest_first(folder / name):
            if len(lines) == MOST_LINES:
                return LogView(lines=lines)
            if _is_about(record, identity):
                lines.append(_line(record))
    return LogView(lines=lines)


def _is_about(record: Mapping[str, Any], identity: DeviceIdentity) -> bool:
    known = asdict(identity)
    worn = all(record.get(key, known[key]) == known[key] for key in ("participant", "label"))
    return worn and all(record.get(key) == known[key] for key in ("sensor", "unit"))


def _newest_first(path: Path) -> Iterator[dict[str, Any]]:
    for text in reversed(_end_of(path).splitlines()):
        try:
            record = json.loads(text)
        except (ValueError, RecursionError):
            # The first line may be cut, and the last one may be incomplete.
            continue
        if isinstance(record, dict):
            yield record


def _end_of(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - MOST_BYTES))
            return file.read(MOST_BYTES)
    except OSError:
        return b""


def _line(record: dict[str, Any]) -> LogLine:
    sentence = on_one_line(sentence_of(record))
    return LogLine(
        time=str(record.get("timestamp", ""))[:40],
        level=str(record.get("level", ""))[:10],
        sentence=sentence if len(sentence) <= _MOST_LETTERS else f"{sentence[:_MOST_LETTERS]} …",
    )
