"""Pauses and resumes the devices of a running agent, and remembers it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import structlog

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.control_server import Command
from biosensor_gateway.agent.pauses import store
from biosensor_gateway.agent.pauses.selection import chosen, device_name
from biosensor_gateway.agent.pauses.store import Pause
from biosensor_gateway.streaming.sink import DeviceSink

WRITTEN_WITHIN_S = 0.5
"""An answer does not wait longer for the disk; who asks again hears how it went on."""

_log = structlog.get_logger("biosensor_gateway.pauses")


class PauseCommands:
    """The devices of an agent, and who of them is paused.

    Those that were paused before the agent was started are paused from the beginning.

    Parameters
    ----------
    folder
        The state folder.
    sinks
        Tells those of all devices.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if what is kept of earlier pauses cannot be understood.
    """

    def __init__(self, folder: Path, sinks: Callable[[], Iterable[DeviceSink]]) -> None:
        self._folder = folder
        self._all_sinks = sinks
        self._writing = asyncio.Lock()
        self._unfinished: set[asyncio.Task[str | None]] = set()
        self._pauses = store.load(folder)
        self.take_over()

    @property
    def commands(self) -> dict[str, Command]:
        """What the control channel offers; the argument ``device`` names one."""
        return {"pause": self._pause, "resume": self._resume}

    def take_over(self) -> None:
        """Pause the devices that were paused earlier; for those that are new, too."""
        for pause in self._pauses:
            for identity, sink in self._sinks.items():
                if pause.holds_for(identity) and not sink.is_paused:
                    self._hold(sink, pause)

    @property
    def _sinks(self) -> dict[DeviceIdentity, DeviceSink]:
        return {sink.identity: sink for sink in self._all_sinks()}

    def _hold(self, sink: DeviceSink, pause: Pause) -> None:
        sink.pause(pause.since.timestamp())
        _log.warning(
            "the device is paused, and nothing of it is sent until it is resumed",
            sensor=sink.identity.sensor,
            unit=sink.identity.unit,
            since=pause.since.isoformat(timespec="seconds"),
            resume_with=f"biosensor-gateway resume {device_name(sink.identity)}",
        )

    async def _pause(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        sink = self._sink(arguments)
        changed = not sink.is_paused
        sink.pause()
        if changed:
            self._pauses.append(Pause(sink.identity, datetime.now().astimezone()))
        return await self._outcome(sink, changed=changed)

    async def _resume(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        sink = self._sink(arguments)
        changed = sink.is_paused
        sink.resume()
        self._pauses = [each for each in self._pauses if not each.holds_for(sink.identity)]
        return await self._outcome(sink, changed=changed)

    def _sink(self, arguments: Mapping[str, Any]) -> DeviceSink:
        name = arguments.get("device")
        if not isinstance(name, str):
            raise ConfigError(ConfigReason.WRONG_VALUE, "the argument 'device' is not a text")
        sinks = self._sinks
        return sinks[chosen(name, sinks)]

    async def _outcome(self, sink: DeviceSink, *, changed: bool) -> Mapping[str, Any]:
        """Write down what holds now, also if nothing changed: it may have failed before."""
        identity = sink.identity
        names = {"sensor": identity.sensor, "unit": identity.unit}
        if changed:
            _log.warning("paused" if sink.is_paused else "resumed", **names)
        problem, pending = await self._in_time(asyncio.create_task(self._written(names)))
        return {
            "device": device_name(identity),
            "changed": changed,
            "problem": problem,
            "pending": pending,
        }

    async def _in_time(self, writing: asyncio.Task[str | None]) -> tuple[str | None, bool]:
        """Return why it is not written, and whether it still may be."""
        self._unfinished.add(writing)
        writing.add_done_callback(self._unfinished.discard)
        done, _ = await asyncio.wait({writing}, timeout=WRITTEN_WITHIN_S)
        if done:
            return writing.result(), False
        path = self._folder / store.PAUSED_FILE
        return f"{path} is not written yet: the disk or the computer is busy", True

    async def _written(self, names: Mapping[str, str]) -> str | None:
        """Write the file beside the loop, which streams on; return why it could not be."""
        async with self._writing:
            try:
                await asyncio.to_thread(store.save, self._folder, tuple(self._pauses))
            except OSError as error:
                path = self._folder / store.PAUSED_FILE
                problem = f"cannot write {path}: {error.strerror or error}"
                _log.error("the state of pauses is not kept", **names, problem=problem)
                return problem
        return None
