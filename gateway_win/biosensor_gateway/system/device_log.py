"""Logs about one device by its names, and says once what would be said at every connection."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import structlog

from biosensor_common.spec import DeviceIdentity


class Once:
    """Tells what is new; called with the same again, it is not."""

    def __init__(self) -> None:
        self._known: set[tuple[Hashable, ...]] = set()

    def __call__(self, *what: Hashable) -> bool:
        """Whether this is the first time."""
        is_new = what not in self._known
        self._known.add(what)
        return is_new


class DeviceLog:
    """Writes about one device, with its sensor and unit.

    Parameters
    ----------
    name
        Whose sentences they are: ``biosensor_gateway.`` and the sensor.
    """

    def __init__(self, name: str, identity: DeviceIdentity) -> None:
        self._log: Any = structlog.get_logger(name)
        self._names = {"sensor": identity.sensor, "unit": identity.unit}
        self._is_new = Once()

    def info(self, event: str, **facts: object) -> None:
        """Say what a user may want to know."""
        self._log.info(event, **self._names, **facts)

    def warning(self, event: str, **facts: object) -> None:
        """Say what a user should look at."""
        self._log.warning(event, **self._names, **facts)

    def error(self, event: str, **facts: object) -> None:
        """Say what must not happen."""
        self._log.error(event, **self._names, **facts)

    def warn_once(self, event: str, **facts: object) -> None:
        """Say it the first time, whatever the facts of later times."""
        if self._is_new(event):
            self.warning(event, **facts)
