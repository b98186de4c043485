"""Pauses and resumes the devices of a running agent, and remembers it."""

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
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.control_server import Command
from biosensor_gateway.agent.selection import chosen, device_name
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file

WRITTEN_WITHIN_S = 0.5
"""An answer does not wait longer for the disk; who asks again hears how it went on."""

_log = structlog.get_logger("biosensor_gateway.pauses")

PAUSED_FILE = "paused.json"
_FIELDS = ("sensor", "unit", "participant", "label")


@dataclass(frozen=True, slots=True)
class Pause:
    """A pause as it is kept.

    Attributes
    ----------
    identity
        The device as the settings had it when it was paused.
    since
        Local time, with its offset.
    """

    identity: DeviceIdentity
    since: datetime

    def holds_for(self, identity: DeviceIdentity) -> bool:
        """Whether a device is the paused one, also if its settings were changed.

        It is if it has the same streams: the strap of that person was replaced. It is
        also if it is the same unit, unless another person wears it by now.
        """
        mine = self.identity
        if naming.source_id(mine, "") == naming.source_id(identity, ""):
            return True
        is_another_person = (
            bool(mine.participant and identity.participant)
            and mine.participant != identity.participant
        )
        same_unit = (mine.sensor, mine.unit) == (identity.sensor, identity.unit)
        return same_unit and not is_another_person


def load_pauses(folder: Path) -> list[Pause]:
    """Read the pauses that are kept in a state folder.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if there is a file and it cannot be understood: nobody knows
        then who has withdrawn.
    """
    path = folder / PAUSED_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return [_pause(entry) for entry in content["paused"]]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        message = (
            f"{path}: it cannot be read who has withdrawn ({error}), so nothing is streamed; "
            "correct the file, or remove it if nobody has"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def save_pauses(folder: Path, pauses: Iterable[Pause]) -> None:
    """Replace what is kept, in one step that also survives a loss of power.

    Raises
    ------
    OSError
        The folder cannot be written; what was kept before still is.
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
        raise ValueError("a name is no text")
    return Pause(DeviceIdentity(*cast("list[str]", texts)), datetime.fromisoformat(entry["since"]))


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
        self._pauses = load_pauses(folder)
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
        path = self._folder / PAUSED_FILE
        return f"{path} is not written yet: the disk or the computer is busy", True

    async def _written(self, names: Mapping[str, str]) -> str | None:
        """Write the file beside the loop, which streams on; return why it could not be."""
        async with self._writing:
            try:
                await asyncio.to_thread(save_pauses, self._folder, tuple(self._pauses))
            except OSError as error:
                path = self._folder / PAUSED_FILE
                problem = f"cannot write {path}: {error.strerror or error}"
                _log.error("the state of pauses is not kept", **names, problem=problem)
                return problem
        return None
