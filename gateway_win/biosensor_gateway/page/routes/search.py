"""Searches for devices, and tests a device by connecting to it for some seconds."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence

from fastapi import APIRouter
from pydantic import BaseModel, Field, ValidationError

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.devices.registry import driver
from biosensor_gateway.doctor import scan
from biosensor_gateway.doctor.device_test import DeviceTestResult, described, run_device_test
from biosensor_gateway.doctor.scan import SearchedPlace
from biosensor_gateway.page.models import Body
from biosensor_gateway.page.routes.api import OneAtATime
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings.models import DeviceSettings


class SearchView(BaseModel):
    """Progress of a search; the places are those of ``scan --json``."""

    running: bool = False
    seconds: float = 0.0
    elapsed_s: float = 0.0
    places: list[SearchedPlace] = Field(default_factory=list[SearchedPlace])
    done: bool = False


def add_search(router: APIRouter, session: Session) -> None:
    """Add the routes that find and test devices."""
    search = Search(session.configured)
    once = OneAtATime("another device is being tested; wait for the result")

    @router.get("/search")
    async def found() -> SearchView:
        """Return the progress of the search for devices."""
        return search.view()

    @router.post("/search")
    async def look() -> SearchView:
        """Search for devices in reach."""
        search.start()
        return search.view()

    @router.post("/devices/test")
    async def test(candidate: Candidate) -> DeviceTestResult:
        """Connect to a device for some seconds; nothing is streamed."""
        settings = settings_of(candidate.sensor, candidate.settings)
        # The agent may stream others meanwhile.
        if (settings.sensor_name, settings.unit) in session.streamed():
            message = "the agent is using this device; its card shows what it sends"
            raise TransportError(TransportReason.BUSY, message)
        with once.turn():
            return described(await run_device_test(settings, TRIAL_S))


SEARCH_S = 6.0


class Search:
    """Runs one search at a time."""

    def __init__(self, configured: Callable[[], Sequence[DeviceSettings]]) -> None:
        self._configured = configured
        self._task: asyncio.Task[None] | None = None
        self._begun_s = 0.0
        self._places: list[SearchedPlace] = []

    def start(self) -> None:
        """Begin to search.

        Raises
        ------
        ConfigError
            ``IN_USE`` if a search is going on.
        """
        if self._is_running:
            raise ConfigError(ConfigReason.IN_USE, "a search is running; wait until it ends")
        self._begun_s = time.monotonic()
        self._places = []
        self._task = asyncio.create_task(self._run())

    def view(self) -> SearchView:
        """Return the progress of the search."""
        if self._task is None:
            return SearchView(seconds=SEARCH_S)
        # Some may have been added since.
        scan.mark_known(self._places, self._configured())
        return SearchView(
            running=self._is_running,
            seconds=SEARCH_S,
            elapsed_s=min(SEARCH_S, time.monotonic() - self._begun_s),
            places=self._places,
            done=not self._is_running,
        )

    @property
    def _is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    async def _run(self) -> None:
        self._places = await scan.scan(SEARCH_S, self._configured())


TRIAL_S = 5.0


class Candidate(Body):
    """A device to test, with the fields that its table in the settings would have."""

    sensor: str
    settings: dict[str, str | int | float | bool]


def settings_of(sensor: str, given: Mapping[str, object]) -> DeviceSettings:
    """Return the settings of a device that was found.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the settings are invalid.
    SpecError
        If the sensor is unknown.
    """
    fields: Mapping[str, object] = {"unit": "trial", **given}
    try:
        return driver(sensor).settings.model_validate({**fields, "sensor": sensor})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the settings"
        raise ConfigError(ConfigReason.WRONG_VALUE, f"{place}: {first['msg']}") from None
