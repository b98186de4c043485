"""The API `/api/v1`: what the page can ask for; see `models` for what it answers."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    CredentialError,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.doctor.device_test import described, run_device_test
from biosensor_gateway.doctor.told import DeviceTestResult
from biosensor_gateway.page.devices import add_devices, asked, started
from biosensor_gateway.page.doctor import Doctor, add_doctor
from biosensor_gateway.page.front import PREFIX
from biosensor_gateway.page.marker_models import MarkerNumber, NewMarker
from biosensor_gateway.page.marking import Marking
from biosensor_gateway.page.models import (
    DeviceName,
    NewRecording,
    Outcome,
    Problem,
    SearchView,
    StatusView,
)
from biosensor_gateway.page.network_answer import NetworkAnswer, add_network_answer
from biosensor_gateway.page.network_check import NetworkCheck, add_network_check
from biosensor_gateway.page.recorder import Recorder
from biosensor_gateway.page.recordings import add_replay
from biosensor_gateway.page.refusals import add_refusals
from biosensor_gateway.page.replaying import Replaying
from biosensor_gateway.page.searching import Search
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings import secrets
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName
from biosensor_gateway.system.console_lines import on_one_line, sentence_of
from biosensor_gateway.system.logs import LOG_FILE_NAME

MOST_LINES = 20
MOST_BYTES = 256 * 1024
"""That is read of a file, from its end."""
_MOST_LETTERS = 400
# When a file is full, the next one begins empty.
_FILES = (LOG_FILE_NAME, f"{LOG_FILE_NAME}.1")
SECONDS = 5.0


def add_api(
    app: FastAPI,
    session: Session,
    recorder: Recorder,
    marking: Marking,
    answer: NetworkAnswer,
    replaying: Replaying,
) -> None:
    """Add everything under `/api/v1`, and how refusals are told."""
    router = APIRouter(prefix=PREFIX, responses={400: {"model": Problem}})
    _add_agent(router, session)
    _add_search(router, session)
    add_devices(router, session)
    _add_pauses(router, session)
    _add_recording(router, recorder)
    _add_markers(router, marking)
    add_device_test(router, DeviceTester(session.streamed))
    add_device_log(router, session.folder)
    add_access(router, Access(session.configured))
    add_doctor(router, Doctor(session.settings, session.folder))
    add_network_check(router, NetworkCheck(session.settings, session.folder))
    add_network_answer(router, answer)
    add_replay(router, recorder, replaying)
    app.include_router(router)
    add_refusals(app)


def _add_agent(router: APIRouter, session: Session) -> None:
    @router.get("/status")
    async def status() -> StatusView:
        """Say how the agent and its devices are."""
        return session.status()

    @router.post("/agent/start")
    async def start() -> Outcome:
        """Start the agent with the devices of the settings."""
        if not any(each.enabled for each in session.configured()):
            message = "the settings name no device yet; add one first"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        return started(session, virtual=False)

    @router.post("/agent/try")
    async def start_virtual() -> Outcome:
        """Start the agent with virtual devices of every kind."""
        return started(session, virtual=True)

    @router.post("/agent/stop")
    async def stop() -> Outcome:
        """End the agent; every stream ends with it."""
        await asked(session, "stop", {})
        return Outcome(sentence="The agent has been told to end.")


def _add_search(router: APIRouter, session: Session) -> None:
    search = Search(session.configured)

    @router.get("/search")
    async def found() -> SearchView:
        """Say how far the search for devices is."""
        return search.view()

    @router.post("/search")
    async def look() -> SearchView:
        """Search for devices in reach."""
        search.start()
        return search.view()


def _add_pauses(router: APIRouter, session: Session) -> None:
    @router.post("/devices/pause")
    async def pause(device: DeviceName) -> Outcome:
        """Send nothing of a device from now on, until it is resumed."""
        return await _switched(session, "pause", device)

    @router.post("/devices/resume")
    async def resume(device: DeviceName) -> Outcome:
        """Send again what a device measures from now on."""
        return await _switched(session, "resume", device)


def _add_recording(router: APIRouter, recorder: Recorder) -> None:
    @router.post("/recording/start")
    async def start(recording: NewRecording) -> Outcome:
        """Begin to record all streams."""
        return await recorder.start(recording)

    @router.post("/recording/stop")
    async def stop() -> Outcome:
        """End the recording, and judge it."""
        return await recorder.stop()


def _add_markers(router: APIRouter, marking: Marking) -> None:
    @router.post("/markers")
    async def mark(marker: NewMarker) -> Outcome:
        """Send a marker, stamped with now."""
        return Outcome(sentence=await marking.mark(marker))

    @router.post("/markers/undo")
    async def undo(which: MarkerNumber) -> Outcome:
        """Say that a marker was a mistake; nothing is deleted."""
        await marking.undo(which.id)
        return Outcome(sentence="The marker is marked as a mistake; it stays in the recording.")


async def _switched(session: Session, command: str, device: DeviceName) -> Outcome:
    answer = await asked(session, command, {"device": f"{device.sensor}/{device.unit}"})
    problem = answer.get("problem")
    if problem and not answer.get("pending"):
        # It is done; only the next start of the agent does not know.
        return Outcome(sentence=f"Done, but it is not kept for the next start: {problem}.")
    return Outcome(sentence=f"The device is {command}d.")


class SecretView(BaseModel):
    """A secret that a device of the settings needs, without its text.

    Attributes
    ----------
    sensor, name
        Which one.
    title
        What people call it.
    where
        Where it is found; empty if it is nowhere.
    problem
        Why it is not found; empty if it is.
    """

    sensor: str
    sensor_title: str
    name: str
    title: str
    where: str = ""
    problem: str = ""


class NewSecret(BaseModel):
    """A secret to keep. Its text is in no answer, log or error."""

    model_config = ConfigDict(extra="forbid", strict=True, hide_input_in_errors=True)

    sensor: str
    name: str
    text: str


class Access:
    """The secrets of the devices in the settings.

    Parameters
    ----------
    configured
        Tells the devices of the settings.
    """

    def __init__(self, configured: Callable[[], Sequence[DeviceSettings]]) -> None:
        self._configured = configured

    async def view(self) -> list[SecretView]:
        """Say which secrets are needed and where each is found."""
        needed = self._needed().values()
        return await asyncio.to_thread(lambda: [_view(each) for each in needed])

    async def keep(self, secret: NewSecret) -> None:
        """Write a secret into the keyring.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if no device of the settings needs it.
        CredentialError
            It is empty, or there is no keyring.
        """
        name = self._needed().get((secret.sensor, secret.name))
        if name is None:
            message = f"no device in the settings needs {secret.name!r} of {secret.sensor!r}"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        await asyncio.to_thread(secrets.set_secret, name, secret.text)

    def _needed(self) -> Mapping[tuple[str, str], SecretName]:
        sensors = {each.sensor for each in self._configured()}
        names = [name for sensor in sorted(sensors) for name in driver(sensor).secrets]
        return {(each.sensor, each.name): each for each in names}


def add_access(router: APIRouter, access: Access) -> None:
    """Add what is asked of secrets; there is no way to read one."""

    @router.get("/secrets")
    async def view() -> list[SecretView]:
        """Say which secrets the devices of the settings need, and which are missing."""
        return await access.view()

    @router.put("/secrets")
    async def keep(secret: NewSecret) -> Outcome:
        """Keep a secret in the keyring of the system."""
        await access.keep(secret)
        return Outcome(sentence="It is in the keyring. The agent tries again within 30 s.")


def _view(name: SecretName) -> SecretView:
    view = SecretView(
        sensor=name.sensor,
        sensor_title=declaration(name.sensor).title,
        name=name.name,
        title=name.title,
    )
    try:
        return view.model_copy(update={"where": secrets.secret_origin(name)})
    except CredentialError as error:
        return view.model_copy(update={"problem": str(error)})


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
    """What the log says last of a device, the newest first; nothing if there is no log."""

    lines: list[LogLine] = Field(default_factory=list[LogLine])


def add_device_log(router: APIRouter, folder: Path) -> None:
    """Add what the page asks of the log in the state folder of the agent."""

    @router.get("/devices/log")
    async def device_log(sensor: str, unit: str) -> LogView:  # pyright: ignore[reportUnusedFunction]
        """Say what the log says last of a device."""
        return await asyncio.to_thread(last_lines, folder, sensor, unit)


def last_lines(folder: Path, sensor: str, unit: str) -> LogView:
    """Return the newest lines about a device, `MOST_LINES` at most.

    Of each file the last `MOST_BYTES` are read; what is no line of the log is passed over.

    Parameters
    ----------
    folder
        The state folder of the agent.
    sensor, unit
        Which device.
    """
    lines: list[LogLine] = []
    for name in _FILES:
        for record in _newest_first(folder / name):
            if len(lines) == MOST_LINES:
                return LogView(lines=lines)
            if (record.get("sensor"), record.get("unit")) == (sensor, unit):
                lines.append(_line(record))
    return LogView(lines=lines)


def _newest_first(path: Path) -> Iterator[dict[str, Any]]:
    for text in reversed(_end_of(path).splitlines()):
        try:
            record = json.loads(text)
        except (ValueError, RecursionError):
            # It begins within a line, and the last one may be half written.
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


class Candidate(BaseModel):
    """A device that may not be in the settings yet: what its table there would have."""

    model_config = ConfigDict(extra="forbid", strict=True)

    sensor: str
    settings: dict[str, str | int | float | bool]


class DeviceTester:
    """Tests one device at a time, beside an agent that streams others.

    Parameters
    ----------
    streamed
        Tells the devices that the agent is connected to, as sensor and unit.
    """

    def __init__(self, streamed: Callable[[], Sequence[tuple[str, str]]]) -> None:
        self._streamed = streamed
        self._is_busy = False

    async def run(self, candidate: Candidate) -> DeviceTestResult:
        """Connect, listen for `SECONDS`, and judge.

        Raises
        ------
        ConfigError
            ``WRONG_VALUE`` if no device can be made of this; ``IN_USE`` while another is tested.
        TransportError
            ``BUSY`` if the agent has the device.
        SpecError
            No sensor is called so.
        """
        settings = _settings(candidate)
        if (settings.sensor_name, settings.unit) in self._streamed():
            message = "the agent has this device; its card shows what it sends"
            raise TransportError(TransportReason.BUSY, message)
        if self._is_busy:
            message = "another device is being tried; wait for the outcome"
            raise ConfigError(ConfigReason.IN_USE, message)
        self._is_busy = True
        try:
            return described(await run_device_test(settings, SECONDS))
        finally:
            self._is_busy = False


def add_device_test(router: APIRouter, tester: DeviceTester) -> None:
    """Add how a device is tested."""

    @router.post("/devices/test")
    async def run(candidate: Candidate) -> DeviceTestResult:
        """Connect to a device for some seconds; nothing is streamed."""
        return await tester.run(candidate)


def _settings(candidate: Candidate) -> DeviceSettings:
    fields: Mapping[str, object] = {"unit": "trial", **candidate.settings}
    try:
        return driver(candidate.sensor).settings.model_validate(
            {**fields, "sensor": candidate.sensor}
        )
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the settings"
        raise ConfigError(ConfigReason.WRONG_VALUE, f"{place}: {first['msg']}") from None
