"""Logs about one device, and logs once what every connection would repeat."""

from __future__ import annotations

from collections.abc import Generator, Hashable
from contextlib import contextmanager
from typing import Any

import structlog

from biosensor_common.spec import DeviceIdentity


class Once:
    """Returns True at the first call with given arguments, and False at later ones."""

    def __init__(self) -> None:
        self._known: set[tuple[Hashable, ...]] = set()

    def __call__(self, *what: Hashable) -> bool:
        """Whether this is the first time."""
        is_new = what not in self._known
        self._known.add(what)
        return is_new


_names_wearers = False


@contextmanager
def wearers_in_log() -> Generator[None]:
    """Have records name who wears a device, as virtual ones of several people share a unit.

    Those of real devices do not, because a unit is that of one device.
    """
    global _names_wearers  # noqa: PLW0603 - as all of logging, it is of the whole process
    before, _names_wearers = _names_wearers, True
    try:
        yield
    finally:
        _names_wearers = before


def names_in_log(identity: DeviceIdentity) -> dict[str, str]:
    """Return the fields by which records say which device they are about."""
    names = {"sensor": identity.sensor, "unit": identity.unit}
    worn = {"participant": identity.participant, "label": identity.label}
    # Also empty ones: who wears it is not unknown then.
    return names | worn if _names_wearers else names


class DeviceLog:
    """Logs about one device, with the fields that name it.

    Parameters
    ----------
    name
        Name of the logger: ``biosensor_gateway.`` and the sensor.
    """

    def __init__(self, name: str, identity: DeviceIdentity) -> None:
        self._log: Any = structlog.get_logger(name)
        self._names = names_in_log(identity)
        self._is_new = Once()

    def info(self, event: str, **facts: object) -> None:
        """Log what a user may want to know."""
        self._log.info(event, **self._names, **facts)

    def warning(self, event: str, **facts: object) -> None:
        """Log what a user should look at."""
        self._log.warning(event, **self._names, **facts)

    def error(self, event: str, **facts: object) -> None:
        """Log what must not happen."""
        self._log.error(event, **self._names, **facts)

    def warn_once(self, event: str, **facts: object) -> None:
        """Log a warning the first time; later calls with the same event do nothing."""
        if self._is_new(event):
            self.warning(event, **facts)
