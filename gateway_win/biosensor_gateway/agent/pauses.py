"""Pauses and resumes the devices of a running agent, and stores the pauses on disk."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, cast

import structlog

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.control_server import Command
from biosensor_gateway.agent.device_states import chosen, device_name, unique_names
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file
from biosensor_gateway.system.device_log import names_in_log

WRITTEN_WITHIN_S = 0.5
"""How long an answer waits for the disk; a client that asks again gets the outcome."""

_log = structlog.get_logger("biosensor_gateway.pauses")

PAUSED_FILE = "paused.json"
_FIELDS = ("sensor", "unit", "participant", "label")


@dataclass(frozen=True, slots=True)
class Pause:
    """A pause as it is stored."""

    identity: DeviceIdentity
    since: datetime  # Local time, with its offset.

    def holds_for(self, identity: DeviceIdentity) -> bool:
        """Whether this pause applies to a device, also if its settings were changed."""
        mine = self.identity
        # The same streams: the person's strap was replaced by another unit.
        if naming.source_id(mine, "") == naming.source_id(identity, ""):
            return True
        # The same unit stays paused, unless another person wears it by now.
        is_another_person = (
            bool(mine.participant and identity.participant)
            and mine.participant != identity.participant
        )
        same_unit = (mine.sensor, mine.unit) == (identity.sensor, identity.unit)
        return same_unit and not is_another_person


def load_pauses(folder: Path) -> list[Pause]:
    """Read the pauses that are stored in a state folder.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the file exists and is damaged: then it is unknown who has withdrawn.
    """
    path = folder / PAUSED_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return [_pause(entry) for entry in content["paused"]]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        message = (
            f"{path}: cannot read who has withdrawn ({error}), so nothing is streamed; "
            "correct the file, or remove it if nobody has"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def save_pauses(folder: Path, pauses: Iterable[Pause]) -> None:
    """Replace the stored pauses atomically, so that a loss of power leaves the old or the new.

    Raises
    ------
    OSError
        If the folder cannot be written; the old pauses are still stored.
    """
    entries = [
        {name: getattr(each.identity, name) for name in _FIELDS} | {"since": each.since.isoformat()}
        for each in pauses
    ]
    path = folder / PAUSED_FILE
    if not entries:
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
        return
    state_file.replace(path, json.dumps({"paused": entries}, indent=1), durable=True)


def _pause(entry: Mapping[str, Any]) -> Pause:
    texts = [cast("object", entry[name]) for name in _FIELDS]
    if not all(isinstance(text, str) for text in texts):
        raise ValueError("a name is not text")
    return Pause(DeviceIdentity(*cast("list[str]", texts)), datetime.fromisoformat(entry["since"]))


class PauseCommands:
    """Commands that pause and resume devices.

    Devices that were paused before the agent was started are paused from the beginning.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the file of earlier pauses is damaged.
    """

    def __init__(self, folder: Path, sinks: Callable[[], Iterable[DeviceSink]]) -> None:
        self._folder = folder
        self._all_sinks = sinks
        self._writing = asyncio.Lock()
        self._unfinished: set[asyncio.Task[str | None]] = set()
        self._pauses = load_pauses(folder)
        self.take_over()

    @property
    def commands(self) -> dict[str, Command]:
        """The commands by name; their argument ``device`` names a device."""
        return {"pause": self._pause, "resume": self._resume}

    def take_over(self) -> None:
        """Pause all devices to which a stored pause applies; called again for new devices."""
        for pause in self._pauses:
            for identity, sink in self._sinks.items():
                if self._holds_for(pause, identity) and not sink.is_paused:
                    self._hold(sink, pause)

    def _holds_for(self, pause: Pause, identity: DeviceIdentity) -> bool:
        """Whether a pause applies to a device; if the paused one is present, only to that one."""
        is_exact = pause.identity == identity
        return is_exact or (pause.identity not in self._sinks and pause.holds_for(identity))

    @property
    def _sinks(self) -> dict[DeviceIdentity, DeviceSink]:
        return {sink.identity: sink for sink in self._all_sinks()}

    def _hold(self, sink: DeviceSink, pause: Pause) -> None:
        sink.pause(pause.since.timestamp())
        _log.warning(
            "the device is paused, and nothing is sent from it until it is resumed",
            sensor=sink.identity.sensor,
            unit=sink.identity.unit,
            since=pause.since.isoformat(timespec="seconds"),
            resume_with=f"biosensor-gateway resume {self._callable(sink.identity)}",
        )

    def _callable(self, identity: DeviceIdentity) -> str:
        known = list(self._sinks)
        name = unique_names(known)[known.index(identity)]
        return f'"{name}"' if " " in name else name

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
        self._pauses = [each for each in self._pauses if not self._holds_for(each, sink.identity)]
        return await self._outcome(sink, changed=changed)

    def _sink(self, arguments: Mapping[str, Any]) -> DeviceSink:
        name = arguments.get("device")
        if not isinstance(name, str):
            raise ConfigError(ConfigReason.WRONG_VALUE, "the argument 'device' is not text")
        sinks = self._sinks
        return sinks[chosen(name, sinks)]

    async def _outcome(self, sink: DeviceSink, *, changed: bool) -> Mapping[str, Any]:
        """Store the pauses, and return the answer to the command."""
        identity = sink.identity
        names = names_in_log(identity)
        if changed:
            _log.warning("paused" if sink.is_paused else "resumed", **names)
        # Stored again even if nothing has changed, because the last attempt may have failed.
        problem, pending = await self._in_time(asyncio.create_task(self._written(names)))
        return {
            "device": device_name(identity),
            "changed": changed,
            "problem": problem,
            "pending": pending,
        }

    async def _in_time(self, writing: asyncio.Task[str | None]) -> tuple[str | None, bool]:
        """Return why the file is not written, and whether it may still be."""
        self._unfinished.add(writing)
        writing.add_done_callback(self._unfinished.discard)
        done, _ = await asyncio.wait({writing}, timeout=WRITTEN_WITHIN_S)
        if done:
            return writing.result(), False
        path = self._folder / PAUSED_FILE
        return f"{path} is not written yet: the disk or the computer is busy", True

    async def _written(self, names: Mapping[str, str]) -> str | None:
        """Write the file on another thread, while the loop streams; return why that failed."""
        async with self._writing:
            try:
                await asyncio.to_thread(save_pauses, self._folder, tuple(self._pauses))
            except OSError as error:
                path = self._folder / PAUSED_FILE
                problem = cannot_write(path, error)
                _log.error("the list of paused devices is not saved", **names, problem=problem)
                return problem
        return None
