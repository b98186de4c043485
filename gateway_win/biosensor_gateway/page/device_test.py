"""Connects to a device for some seconds to see what it sends, before a study relies on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, ValidationError

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.devices.registry import driver
from biosensor_gateway.doctor.device_test import DeviceTestResult, described, run_device_test
from biosensor_gateway.settings.models import DeviceSettings

SECONDS = 5.0


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
