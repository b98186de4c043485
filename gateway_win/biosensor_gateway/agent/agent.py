"""Runs all devices of the settings, each under its own supervisor."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import pylsl
import structlog
from pydantic import BaseModel, Field, TypeAdapter
from pylsl import local_clock

from biosensor_common.device_clock import ClockState
from biosensor_common.errors import cannot_write
from biosensor_common.lsl import api_file
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.naming import AGENT, source_id
from biosensor_common.process_limits import limit_arenas
from biosensor_common.refusal import LATELY_S, Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import feature_refusals, status_file
from biosensor_gateway.agent.control_server import Command, Conversation
from biosensor_gateway.agent.device_set import (
    Device,
    DeviceChanges,
    DeviceSet,
    Problem,
    ReadSettings,
    SettingsReload,
    problem,
)
from biosensor_gateway.agent.device_states import CONNECTED, unique_names
from biosensor_gateway.agent.feed import Feed
from biosensor_gateway.agent.marker_commands import MarkerCommands
from biosensor_gateway.agent.pauses import PauseCommands
from biosensor_gateway.agent.status import AgentStatus, RefusedStatus
from biosensor_gateway.agent.status_file import STATUS_FILE
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.marker_stream import MarkerStream
from biosensor_gateway.streaming.outlets import Outlet, own_outlet
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file
from biosensor_gateway.system.keep_alive import restart_facts
from biosensor_gateway.system.keep_awake import KeepAwake, system_inhibitor

REPORT_INTERVAL_S = 1.0

_log = structlog.get_logger("biosensor_gateway.agent")


def snapshot(
    devices: Iterable[Device],
    *,
    virtual: bool = False,
    own: Iterable[Refusals] = (),
    features: Sequence[RefusedStatus] = (),
    started_s: float | None = None,
    session: str = "",
) -> AgentStatus:
    """Return the status of the agent and its devices.

    Parameters
    ----------
    features
        Refusals that programs with live features report.
    started_s
        When the agent began, as LSL time.
    session
        LSL session in which it sends.
    """
    restarts = restart_facts(os.environ)
    status = AgentStatus(
        written=time.time(),
        lsl_time=local_clock(),
        started_s=started_s,
        process=os.getpid(),
        virtual=virtual,
        restarts=int(restarts.get("restarts", 0)),
        last_end=str(restarts.get("last_end", "")),
        session=session,
        refusals=[refused for each in own for refused in RefusedStatus.of(each)],
        devices=[device.status() for device in devices],
    )
    feature_refusals.add(status, features)
    return status


def problems_of(
    devices: Mapping[str, Device],
    own: Refusals,
    features: Iterable[RefusedStatus],
    lately_s: float,
) -> dict[str, list[Problem]]:
    """Return what is wrong with the data of each device, for heartbeats.

    Problems of no single device are under `AGENT`; those of a paused device are left out.

    Parameters
    ----------
    devices
        By their names in heartbeats.
    own
        Refusals of the agent's own stream of markers; without that of events there is no heartbeat.
    features
        Refusals that programs with live features report.
    lately_s
        Seconds for which a momentary problem is reported.
    """
    found = {name: device.problems(lately_s) for name, device in devices.items()}
    found[AGENT] = [problem(each) for each in own.within(lately_s)]
    name_of = {each: name for name, device in devices.items() for each in device.lsl_names}
    for about, told in feature_refusals.problems(features, local_clock() - lately_s):
        name = name_of.get(about, AGENT)
        if name == AGENT or not devices[name].sink.is_paused:
            found[name].append(told)
    return {name: of_one for name, of_one in found.items() if of_one}


UNWRITTEN_REPORTS = 3
"""Number of failed writes in a row after which the log reports it."""


class StatusWriter:
    """Writes the status file, and logs once if it cannot be written."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._failures = 0
        self._is_logged = False

    def write(self, status: dict[str, Any]) -> None:
        """Replace the file; after a failure the next report replaces it."""
        try:
            status_file.write_status(self._folder, status)
            self._failures = 0
        except OSError as error:
            self._failures += 1
            # Windows refuses to replace a file while somebody reads it; a second later it works.
            patience = UNWRITTEN_REPORTS if isinstance(error, PermissionError) else 1
            if not self._is_logged and self._failures >= patience:
                self._is_logged = True
                _log.warning(
                    "the status file cannot be written; `status` will not work", error=str(error)
                )


# A recorder takes a second to find a stream again that has vanished, and a device takes seconds to
# be connected. After a crash, streams that are opened from this file let both happen at once.
STREAMS_FILE = "streams.json"
FRESH_S = 300.0
"""Age at which the file is ignored: people may wear other devices by then."""


class _Known(BaseModel):
    identity: DeviceIdentity
    info: DeviceInfo
    rates: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]]


_FILE = TypeAdapter(list[_Known])


class KnownStreams:
    """Stores headers and rates of an agent's streams in a file of the state folder.

    The file exists from the first connection of a device to a clean end of the agent.

    Parameters
    ----------
    sinks
        Returns the sinks of the devices that have room in this process.
    """

    def __init__(self, folder: Path, sinks: Callable[[], Iterable[DeviceSink]]) -> None:
        self._path = folder / STREAMS_FILE
        self._folder = folder
        self._sinks = sinks
        self._stored: list[_Known] = []
        self._has_failed = False

    def reopen(self) -> None:
        """Open the outlets of an agent that crashed a short while ago."""
        sinks = {sink.identity: sink for sink in self._sinks()}
        for known in self._of_crashed_agent():
            sink = sinks.get(known.identity)
            if sink is not None:
                sink.expect(known.info, known.rates)

    def store(self) -> None:
        """Write the file if a stream has changed."""
        known = [
            _Known(identity=sink.identity, info=sink.info, rates=dict(sink.told_rates))
            for sink in self._sinks()
            if sink.is_open
        ]
        if known == self._stored or self._has_failed:
            return
        try:
            state_file.replace(self._path, _FILE.dump_json(known, indent=1).decode())
        except OSError as error:
            # The only loss is that streams appear later after a crash.
            self._has_failed = True
            _log.warning(cannot_write(self._path, error))
        self._stored = known

    def remove(self) -> None:
        """Remove the file, at a clean end of the agent."""
        with contextlib.suppress(OSError):
            self._path.unlink()

    def _of_crashed_agent(self) -> list[_Known]:
        try:
            # The agent writes its status once a second, so the file's time is when it crashed.
            lived_s = (self._folder / STATUS_FILE).stat().st_mtime
            if time.time() - lived_s > FRESH_S:
                return []
            return _FILE.validate_json(state_file.read(self._path))
        except FileNotFoundError:
            return []
        except (OSError, ValueError):
            _log.warning(
                f"{self._path} is damaged, so streams appear only when their devices are "
                "connected; it is then written again"
            )
            return []


class Agent:
    """Runs the enabled devices of the settings until it is cancelled.

    Parameters
    ----------
    settings
        Validated settings; this process's LSL configuration is set from them.
    read_again
        Reads the settings file again; None if there is none.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the file of paused devices cannot be read.
    """

    def __init__(
        self, settings: GatewaySettings, folder: Path, read_again: ReadSettings | None = None
    ) -> None:
        self._folder = folder
        limit_arenas(os.environ)
        taken_over = configure_lsl(settings.lsl.overrides)
        self._lsl_session = api_file.session(api_file.config_here(settings.lsl.overrides))
        if taken_over is not None:
            people = f"LSL's own settings are used: {taken_over}"
            _log.info("LSL configuration used", file=str(taken_over), for_people=people)
        enabled = [device for device in settings.devices if device.enabled]
        devices = {each: Device.from_settings(each) for each in enabled}
        self.devices = DeviceSet(devices, Room.here())
        self._known = KnownStreams(folder, self._sinks_with_room)
        self._pauses = PauseCommands(folder, self._sinks)
        self._markers = MarkerStream()
        self._marker_commands = MarkerCommands(self._markers, settings.markers)
        self._reload = SettingsReload(settings, read_again, self._change, self._preview)
        self._feed = Feed()
        self._heartbeat_s = settings.events.heartbeat_s
        self._feature_refusals: Sequence[RefusedStatus] = ()
        # Called once a second with the contents of the status file, see `AgentStatus`.
        self.on_status: Callable[[Mapping[str, Any]], None] = lambda status: None
        self.on_end: Callable[[], None] = lambda: None  # Called when it begins to close.
        self._status = StatusWriter(folder)
        self._awake = KeepAwake(system_inhibitor() if settings.power.keep_awake else None)

    @property
    def commands(self) -> dict[str, Command]:
        """The commands of the control channel, except ``stop``."""
        reload = {"reload": self._reload.command, "reload-preview": self._reload.preview}
        return {**self._pauses.commands, **reload, **self._marker_commands.commands}

    @property
    def conversations(self) -> dict[str, Conversation]:
        """The subscriptions of the control channel, which last until the client disconnects."""
        return {"feed": self._feed.conversation}

    async def run(self) -> None:
        """Stream until cancelled, then close every device and outlet."""
        self.devices.make_room()
        self._known.reopen()
        counters = own_outlet("counters")
        self._markers.open()
        start = restart_facts(os.environ)
        if start:
            _log.warning("the agent had died and was restarted", **start)
        announcer = Announcer(self._heartbeat_s, self._states, self._problems, start)
        announcer.watch(self._markers.tick)
        self.devices.start(announcer, self._feed)
        tasks = [
            asyncio.create_task(self._report(counters, announcer)),
            asyncio.create_task(announcer.run()),
            asyncio.create_task(self.devices.run()),
        ]
        try:
            await asyncio.gather(*tasks)
        finally:
            self.on_end()
            announcer.announce(EventKind.AGENT_STOPPED, {})
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self.devices.close()
            self._awake.close()
            await asyncio.gather(announcer.end(), self._markers.end())
            counters.close()
            self._known.remove()
            status_file.remove_status(self._folder)

    def _sinks(self) -> list[DeviceSink]:
        return [device.sink for device in self.devices]

    def _sinks_with_room(self) -> list[DeviceSink]:
        return [device.sink for device in self.devices.with_room]

    async def _change(self, settings: GatewaySettings) -> DeviceChanges:
        self._marker_commands.settings = settings.markers
        return await self.devices.change(settings.devices, self._pauses.take_over)

    def _preview(self, settings: GatewaySettings) -> DeviceChanges:
        return self.devices.preview(settings.devices)

    def _states(self) -> dict[str, str]:
        return {name: device.state for name, device in self._named().items()}

    def _problems(self) -> dict[str, list[Problem]]:
        # Back to the last heartbeat at least, so that no problem falls between two of them.
        lately_s = max(LATELY_S, self._heartbeat_s)
        own = self._markers.refusals
        return problems_of(self._named(), own, self._feature_refusals, lately_s)

    def _named(self) -> dict[str, Device]:
        devices = list(self.devices)
        names = unique_names([each.sink.identity for each in devices])
        return dict(zip(names, devices, strict=True))

    async def _report(self, outlet: Outlet, announcer: Announcer) -> None:
        """Once a second, send states and counters to LSL, write the status, keep the PC awake."""
        loop = asyncio.get_running_loop()
        next_s = loop.time()
        while True:
            merged: dict[str, Counters] = announcer.counters | self._markers.counters
            for device in self.devices:
                # Sends states that have waited for a receiver.
                device.sink.release()
                merged |= device.sink.counters
            text = counters_text(
                merged,
                self._clocks(),
                self._refused(),
                self._off(),
                self._away(),
                self._refused_of_devices(),
                self._lacking(),
            )
            outlet.push_text(text, pylsl.local_clock())
            own = (announcer.refusals, self._markers.refusals)
            virtual = self._reload.is_virtual
            features = self._feature_refusals = feature_refusals.read(self._folder)
            status = snapshot(
                self.devices,
                virtual=virtual,
                own=own,
                features=features,
                started_s=announcer.started_s,
                session=self._lsl_session,
            ).model_dump()
            self.on_status(status)
            self._status.write(status)
            self._feed.send_status(status)
            self._known.store()
            # Always from this thread, because Windows keeps such a request per thread.
            self._awake.hold(any(each.supervisor.is_connected for each in self.devices))
            # After the computer has slept, missed reports are skipped.
            next_s = max(next_s + REPORT_INTERVAL_S, loop.time())
            await asyncio.sleep(max(0.0, next_s - loop.time()))

    def _off(self) -> set[str]:
        return {source for device in self.devices for source in device.sink.off}

    def _lacking(self) -> dict[str, Sequence[str]]:
        """Return the channels that models of devices do not have, by source_id."""
        return {
            source_id(device.sink.identity, data_name): labels
            for device in self.devices
            for data_name, labels in device.sink.lacking.items()
        }

    def _away(self) -> dict[str, str]:
        """Return the states of devices that do not send, by the source_ids of their streams."""
        away = [each for each in self.devices if each.state not in CONNECTED]
        return {source: each.state for each in away for source in each.sink.counters}

    def _refused(self) -> dict[str, list[str]]:
        """Return current refusals by source_id, without pauses.

        The count of samples that a pause suppresses would reveal the beats of a person who has
        withdrawn.
        """
        return {
            source: [e.sentence for e in refusals.present if e.what is not Refusal.PAUSED]
            for device in self.devices
            for source, refusals in device.sink.refused.items()
        }

    @property
    def refusals(self) -> Refusals:
        """What is refused of no single device."""
        return self._markers.refusals

    def refusals_of_devices(self) -> dict[str, Refusals]:
        """Return the refusals of each device by the source_id of its first stream."""
        opened = [sink for sink in self._sinks_with_room() if sink.counters]
        return {next(iter(sink.counters)): sink.refusals for sink in opened}

    def _refused_of_devices(self) -> dict[str, list[str]]:
        """Return present refusals that concern no single stream, by a device's first source_id."""
        return {
            next(iter(sink.counters)): [each.sentence for each in sink.refusals.present]
            for sink in (each.sink for each in self.devices)
            if sink.counters
        }

    def _clocks(self) -> dict[str, ClockState]:
        """Return the devices' clocks, each by the source_id of the device's first stream."""
        opened = (each.sink for each in self.devices if each.sink.counters)
        return {next(iter(sink.counters)): sink.clock_state for sink in opened}
