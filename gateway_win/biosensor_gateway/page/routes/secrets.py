"""Takes secrets for vendors' services into the keyring; nobody reads one here."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict

from biosensor_common.errors import ConfigError, ConfigReason, CredentialError
from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.page.models import Outcome
from biosensor_gateway.settings import secrets
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName


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
