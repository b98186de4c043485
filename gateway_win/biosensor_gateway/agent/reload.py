"""The command ``reload``: a running agent reads its settings again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

import structlog

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.device_set import DeviceChanges
from biosensor_gateway.settings.models import GatewaySettings

ANSWERED_WITHIN_S = 3.0
"""How long the answer waits; a device may take longer to disconnect, and the change goes on."""

ReadSettings = Callable[[], GatewaySettings]
"""Reads the settings file again.

Raises
------
ConfigError
    If the file is wrong.
"""

_AT_ONCE = frozenset({"markers"})
"""Sections of the settings, besides the devices, that apply to a running agent at once."""

_log = structlog.get_logger("biosensor_gateway.agent")


class SettingsReload:
    """Reads the settings again on request, and applies changed devices and marker buttons.

    A broken file changes nothing, and the answer says what is wrong with it.

    Parameters
    ----------
    settings
        Settings with which the agent was started.
    read
        Reads the settings again; None if there is no file, as with virtual devices.
    change
        Applies new settings to the devices and the markers.
    preview
        Returns the changes that `change` would make.
    """

    def __init__(
        self,
        settings: GatewaySettings,
        read: ReadSettings | None,
        change: Callable[[GatewaySettings], Awaitable[DeviceChanges]],
        preview: Callable[[GatewaySettings], DeviceChanges],
    ) -> None:
        self._started_with = self._newest = settings
        self._read = read
        self._change, self._preview = change, preview
        self._busy = asyncio.Lock()
        self._task: asyncio.Task[DeviceChanges] | None = None

    @property
    def is_virtual(self) -> bool:
        """Whether there is no file to read."""
        return self._read is None

    async def command(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read the settings and apply what has changed.

        Returns
        -------
        Mapping
            ``added``, ``removed``, ``restarted`` and ``kept``: names of devices; ``now``: other
            changed sections that apply already; ``later``: changed sections that apply from the
            agent's next start on; ``pending``: whether devices are still ending.
        """
        if self._task is not None and not self._task.done():
            message = "the settings are being read again already; try again in some seconds"
            raise ConfigError(ConfigReason.IN_USE, message)
        settings = await self._read_again()
        self._task = asyncio.create_task(self._changed(settings))
        done, _ = await asyncio.wait({self._task}, timeout=ANSWERED_WITHIN_S)
        changes = self._task.result() if done else DeviceChanges()
        now = _different(self._newest, settings, _AT_ONCE)
        later = _different(self._started_with, settings, _sections() - _AT_ONCE)
        self._newest = settings
        return {**asdict(changes), "now": now, "later": later, "pending": not done}

    async def preview(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the devices that `command` would change, under the same keys."""
        return asdict(self._preview(await self._read_again()))

    async def _read_again(self) -> GatewaySettings:
        if self._read is None:
            message = "this agent runs virtual devices, which have no settings file"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        return await asyncio.to_thread(self._read)

    async def _changed(self, settings: GatewaySettings) -> DeviceChanges:
        async with self._busy:
            changes = await self._change(settings)
        _log.info("the settings were read again", **asdict(changes))
        return changes


def _sections() -> set[str]:
    return GatewaySettings.model_fields.keys() - {"devices"}


def _different(
    before: GatewaySettings, after: GatewaySettings, sections: Iterable[str]
) -> list[str]:
    return [name for name in sorted(sections) if getattr(before, name) != getattr(after, name)]
