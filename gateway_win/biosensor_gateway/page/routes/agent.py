"""Starts and ends the agent, gives it its secrets, and quits the page.

Secrets for vendors' services go into the keyring; nothing here reads one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
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
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.stop import stop_agent
from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.page.models import AgentState, Outcome, StatusView
from biosensor_gateway.page.routes.devices import (
    asked,
    started,
)
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.session import Session, Shutdown
from biosensor_gateway.settings import secrets
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName


def add_agent(router: APIRouter, session: Session) -> None:
    """Add how the agent is, begins and ends."""

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


_LOOK_S = 0.2


class Quitting(BaseModel):
    """What becomes of the agent, and of a recording: they end, too, or go on."""

    model_config = ConfigDict(extra="forbid", strict=True)

    rest: Literal["end", "leave"]


def add_quit(router: APIRouter, session: Session, recorder: Recorder, shutdown: Shutdown) -> None:
    """Add `/api/v1/quit`."""

    @router.post("/quit")
    async def leave(quitting: Quitting) -> Outcome:
        """End the page; first the recording and the agent, if they are to end."""
        said = await _end_the_rest(session, recorder) if quitting.rest == "end" else _left(session)
        shutdown.request()
        return Outcome(sentence=" ".join(said))


async def _end_the_rest(session: Session, recorder: Recorder) -> list[str]:
    """End first what must not lose its streams; return what came of each."""
    said: list[str] = []
    if session.recording.is_running:
        said.append((await recorder.stop()).sentence)
    while session.agent is AgentState.STARTING and not is_held(session.folder):  # noqa: ASYNC110 - of another process
        # It cannot be told to end before it is there.
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
        said.append("The agent streams on.")
    if session.recording.is_running:
        said.append("The recording goes on.")
    return said


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


def add_secrets(router: APIRouter, access: Access) -> None:
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
