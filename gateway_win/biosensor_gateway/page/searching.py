"""Searches for devices while the page shows how far it is."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence

from biosensor_common.errors import ConfigError, ConfigReason, SpecError
from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.doctor import scan
from biosensor_gateway.page.models import FoundView, SearchView
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
        known = {(each.sensor, each.unit) for each in self._configured()}
        return SearchView(
            running=self._is_running,
            seconds=SECONDS,
            elapsed_s=min(SECONDS, time.monotonic() - self._begun_s),
            found=[_view(each, known) for part in self._sections for each in part.found],
            problems=[f"{each.title}: {each.problem}" for each in self._sections if each.problem],
            advice=[sentence for each in self._sections for sentence in scan.advice(each)],
            done=not self._is_running,
        )

    @property
    def _is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    async def _run(self) -> None:
        self._sections = await scan.scan(SECONDS, self._configured())


def _view(found: Found, known: set[tuple[str, str]]) -> FoundView:
    try:
        title = declaration(found.sensor).title
    except SpecError:
        title = found.sensor
    return FoundView(
        sensor=found.sensor,
        title=title,
        name=found.name,
        rssi_dbm=found.rssi_dbm,
        settings=dict(found.settings),
        is_known=(found.sensor, str(found.settings.get("unit"))) in known,
    )
