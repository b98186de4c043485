"""Starts and ends the agent, stores its secrets, and quits the page.

Secrets for vendors' services are written to the keyring, and never read here.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    CredentialError,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent.control import stop_agent
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.page.models import AgentState, Body, Choice, Outcome, StatusView
from biosensor_gateway.page.routes.api import QuestionError
from biosensor_gateway.page.routes.devices import (
    SettingsChange,
    asked,
    started,
)
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.session import Session, Shutdown
from biosensor_gateway.recording.recorder.state import lost_by_start
from biosensor_gateway.settings import secrets
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName


def add_agent(router: APIRouter, session: Session) -> None:
    """Add the routes of the agent's status, start and end."""

    @router.get("/status")
    async def status() -> StatusView:
        """Return the status of the agent and its devices."""
        return session.status()

    @router.post("/agent/start")
    async def start(change: SettingsChange) -> Outcome:
        """Start the agent with the devices of the settings."""
        if not any(each.enabled for each in session.configured()):
            message = "there is no device in the settings yet; add one first"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        _ask_first(session, session.configured(), change)
        return started(session, virtual=False)

    @router.post("/agent/try")
    async def start_virtual(change: SettingsChange | None = None) -> Outcome:
        """Start the agent with virtual devices of every kind."""
        _ask_first(session, (), change or SettingsChange())
        return started(session, virtual=True)

    @router.post("/agent/stop")
    async def stop() -> Outcome:
        """End the agent; every stream ends with it."""
        await asked(session, "stop", {})
        return Outcome(sentence="The agent has been asked to end.")


def _ask_first(session: Session, devices: Sequence[DeviceSettings], change: SettingsChange) -> None:
    """Ask before a start with devices that lack sensors of a running recording."""
    lost = lost_by_start(devices, session.folder)
    if lost and not change.while_recording:
        again = Choice(words="Start without it", more={"while_recording": True})
        raise QuestionError("A recording goes on", f"{lost[0].upper()}{lost[1:]}.", [again])


_LOOK_S = 0.2


class Quitting(Body):
    """Whether the agent and a recording end with the page, or continue."""

    rest: Literal["end", "leave"]


def add_quit(router: APIRouter, session: Session, recorder: Recorder, shutdown: Shutdown) -> None:
    """Add `/api/v1/quit`."""

    @router.post("/quit")
    async def leave(quitting: Quitting) -> Outcome:
        """End the page; before it the recording and the agent, if requested."""
        said = await _end_the_rest(session, recorder) if quitting.rest == "end" else _left(session)
        shutdown.request()
        return Outcome(sentence=" ".join(said))


async def _end_the_rest(session: Session, recorder: Recorder) -> list[str]:
    """End the recording, then the agent whose streams it records; return their outcomes."""
    said: list[str] = []
    if session.recording.is_running:
        said.append((await recorder.stop()).sentence)
    while session.agent is AgentState.STARTING and not is_held(session.folder):  # noqa: ASYNC110 - of another process
        # An agent that is starting cannot be asked to end yet.
        await asyncio.sleep(_LOOK_S)
    try:
        await asyncio.to_thread(stop_agent, session.folder)
    except TransportError as error:
        if error.reason is not TransportReason.ABSENT:
            raise
    else:
        said.append("The agent has ended.")
    return said


def _left(session: Session) -> list[str]:
    said: list[str] = []
    if session.agent is not AgentState.ABSENT:
        said.append("The agent continues to stream.")
    if session.recording.is_running:
        said.append("The recording continues.")
    return said


class SecretView(BaseModel):
    """A secret that a device of the settings needs, without its text.

    Attributes
    ----------
    sensor, name
        Identify the secret.
    title
        Name of the secret for people.
    where
        Where it is found; empty if it is not found.
    problem
        Why it is not found; empty if it is found.
    """

    sensor: str
    sensor_title: str
    name: str
    title: str
    where: str = ""
    problem: str = ""


class NewSecret(Body):
    """A secret to store. Its text is in no answer, log or error."""

    model_config = ConfigDict(hide_input_in_errors=True)

    sensor: str
    name: str
    text: str


def add_secrets(router: APIRouter, session: Session) -> None:
    """Add the routes of secrets, none of which returns a secret's text."""

    @router.get("/secrets")
    async def view() -> list[SecretView]:
        """List the secrets that the devices of the settings need, and which are missing."""
        needed = _needed(session.configured()).values()
        return await asyncio.to_thread(lambda: [_view(each) for each in needed])

    @router.put("/secrets")
    async def keep(secret: NewSecret) -> Outcome:
        """Store a secret in the keyring of the system."""
        name = _needed(session.configured()).get((secret.sensor, secret.name))
        if name is None:
            message = f"no device in the settings needs {secret.name!r} of {secret.sensor!r}"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        await asyncio.to_thread(secrets.set_secret, name, secret.text)
        return Outcome(sentence="It is in the keyring. The agent tries again within 30 s.")


def _needed(devices: Sequence[DeviceSettings]) -> Mapping[tuple[str, str], SecretName]:
    sensors = {each.sensor for each in devices}
    names = [name for sensor in sorted(sensors) for name in driver(sensor).secrets]
    return {(each.sensor, each.name): each for each in names}


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
