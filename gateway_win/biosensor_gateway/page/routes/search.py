"""Searches for devices while the page shows how far it is."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.doctor import scan
from biosensor_gateway.page.models import SearchView
from biosensor_gateway.settings.models import DeviceSettings

SECONDS = 6.0


class Search:
    """One search at a time.

    Parameters
    ----------
    configured
        Tells the devices of the settings.
    """

    def __init__(self, configured: Callable[[], Sequence[DeviceSettings]]) -> None:
        self._configured = configured
        self._task: asyncio.Task[None] | None = None
        self._begun_s = 0.0
        self._sections: list[scan.Section] = []

    def start(self) -> None:
        """Begin to search.

        Raises
        ------
        ConfigError
            ``IN_USE`` if a search is going on.
        """
        if self._is_running:
            raise ConfigError(ConfigReason.IN_USE, "a search is going on; wait for its end")
        self._begun_s = time.monotonic()
        self._sections = []
        self._task = asyncio.create_task(self._run())

    def view(self) -> SearchView:
        """Say how far it is."""
        if self._task is None:
            return SearchView(seconds=SECONDS)
        return SearchView(
            running=self._is_running,
            seconds=SECONDS,
            elapsed_s=min(SECONDS, time.monotonic() - self._begun_s),
            places=scan.described(self._sections, self._configured()),
            done=not self._is_running,
        )

    @property
    def _is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    async def _run(self) -> None:
        self._sections = await scan.scan(SECONDS, self._configured())
