"""Has a running agent read its settings again: the command ``reload``."""

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
"""A device may take longer to let go of its connection; the change goes on then."""

ReadSettings = Callable[[], GatewaySettings]
"""Reads the settings file again.

Raises
------
ConfigError
    What is wrong with it.
"""

_AT_ONCE = frozenset({"markers"})
"""Sections of the settings that a running agent takes over, besides the devices."""

_log = structlog.get_logger("biosensor_gateway.agent")


class SettingsReload:
    """Reads the settings again on request, and changes the devices and the buttons of markers.

    A file that is broken changes nothing, and the answer says what is wrong with it.

    Parameters
    ----------
    settings
        As the agent was started.
    read
        Reads them again; None if there is no file, as with virtual devices.
    change
        Takes over what can be.
    preview
        Says what `change` would do.
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
        """Read the settings and change what is different.

        Returns
        -------
        Mapping
            Names by ``added``, ``removed``, ``restarted`` and ``kept``; ``now``: other sections
            that have changed and hold; ``later``: sections that hold from the agent's next start
            on; ``pending``: whether devices are still ending.
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
        """Say which devices `command` would change, by the same names."""
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
