"""Keeps what a run knew of its devices' streams, for the run that comes after a kill.

Recorders look for a stream that has vanished, and take a second to find it again. A device
takes its own seconds to be connected. After a kill both can happen at the same time.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

import structlog
from pydantic import BaseModel, Field, TypeAdapter

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent.status_file import STATUS_FILE
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file

STREAMS_FILE = "streams.json"
FRESH_S = 300.0
"""Who starts an agent later than this begins something new: perhaps other devices are worn."""

_log = structlog.get_logger("biosensor_gateway.agent")


class _Known(BaseModel):
    identity: DeviceIdentity
    info: DeviceInfo
    rates: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]]


_FILE = TypeAdapter(list[_Known])


class KnownStreams:
    """What is known of the streams of an agent's devices, in a file of the state folder.

    The file is there from the first connection of a device to a clean end.

    Parameters
    ----------
    folder
        The state folder.
    sinks
        Returns those of all devices whose streams fit into this process.
    """

    def __init__(self, folder: Path, sinks: Callable[[], Iterable[DeviceSink]]) -> None:
        self._path = folder / STREAMS_FILE
        self._folder = folder
        self._sinks = sinks
        self._kept: list[_Known] = []
        self._has_failed = False

    def expect(self) -> None:
        """Open the outlets that a run had which was killed a short while ago."""
        sinks = {sink.identity: sink for sink in self._sinks()}
        for known in self._left_behind():
            sink = sinks.get(known.identity)
            if sink is not None:
                sink.expect(known.info, known.rates)

    def keep(self) -> None:
        """Write down what is known, if that has changed."""
        known = [
            _Known(identity=sink.identity, info=sink.info, rates=dict(sink.told_rates))
            for sink in self._sinks()
            if sink.is_open
        ]
        if known == self._kept or self._has_failed:
            return
        try:
            state_file.replace(self._path, _FILE.dump_json(known, indent=1).decode())
        except OSError as error:
            # Streams appear later after a kill, and nothing else.
            self._has_failed = True
            _log.warning(f"cannot write {self._path}: {error.strerror or error}")
        self._kept = known

    def forget(self) -> None:
        """Remove the file: the agent ends as it should."""
        with contextlib.suppress(OSError):
            self._path.unlink()

    def _left_behind(self) -> list[_Known]:
        try:
            # Written once a second for as long as the agent lives.
            lived_s = (self._folder / STATUS_FILE).stat().st_mtime
            if time.time() - lived_s > FRESH_S:
                return []
            return _FILE.validate_json(state_file.read(self._path))
        except FileNotFoundError:
            return []
        except (OSError, ValueError):
            _log.warning(
                f"{self._path} is damaged, so streams appear only when their devices are "
                "connected; it is written anew then"
            )
            return []
