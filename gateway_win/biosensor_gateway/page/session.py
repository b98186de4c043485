"""The state of the page's server: the agent, its devices, the settings; and its shutdown."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import feature_refusals
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.status import AgentStatus, DeviceStatus, RefusedStatus
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.page.agent_client import Viewer
from biosensor_gateway.page.live_feed import Traces
from biosensor_gateway.page.models import (
    AgentState,
    ExperimentsView,
    MarkersView,
    RecordingView,
    ReplayView,
    SeenStreamView,
    ShareView,
    StatusView,
)
from biosensor_gateway.recording.participants import Worn
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings

STARTING_S = 15.0


class Session:
    """The state that all requests share; used only on the server's loop."""

    def __init__(self, folder: Path, settings: Path) -> None:
        self.folder = folder
        self.settings = settings
        self.traces = Traces()
        self.recording = RecordingView()
        self.markers = MarkersView()
        # Returns the view of the replay; `Replaying` replaces it.
        self.replay_view: Callable[[], ReplayView] = ReplayView
        self.features: Sequence[SeenStreamView] = ()
        # Features that are not shown, and why; `Features` sets it.
        self.unshown: Sequence[RefusedStatus] = ()
        # Whether the server is about to end, of which its windows are notified.
        self.has_ended = False
        self.turns = 0  # How often an agent has come or gone.
        # Set once a status was returned in which the agent is not starting.
        self.told = asyncio.Event()
        self.came = asyncio.Event()
        self.share: ShareView | None = None
        self.experiments: ExperimentsView | None = None
        self._viewer = Viewer(self.traces.history)
        self._status: AgentStatus | None = None
        self._skipped = 0
        self._started_s = -STARTING_S
        self._loaded: tuple[object, GatewaySettings | ConfigError | None] = None, None

    def take_status(self, status: AgentStatus | None) -> None:
        """Note the agent's status; None if there is no agent."""
        if (status is None) is not (self._status is None):
            self.turns += 1
        self._status = status
        if status is not None:
            feature_refusals.add(status, self.unshown)
            self.came.set()

    def take_dropped(self, count: int) -> None:
        """Count samples that the agent has left out because this server was too slow."""
        self._skipped += count

    def note_start(self) -> None:
        """Show the agent as starting until it answers."""
        self._started_s = time.monotonic()

    @staticmethod
    def now() -> float:
        """Return the LSL time in seconds."""
        # Imported late, because pylsl needs numpy, and the page shows devices before.
        from pylsl import local_clock

        return local_clock()

    def configured(self) -> Sequence[DeviceSettings]:
        """Return the devices of the settings; empty if there is no file, or it is wrong."""
        try:
            return self.loaded().devices
        except ConfigError:
            return ()

    @property
    def agent(self) -> AgentState:
        """Whether an agent runs, is starting or is absent."""
        return AgentState.RUNNING if self.has_agent else self._absence()

    @property
    def has_agent(self) -> bool:
        """Whether an agent sends its status."""
        return self._status is not None

    def streamed(self) -> tuple[tuple[str, str], ...]:
        """Return the devices that the agent has, by sensor and unit."""
        return tuple((each.sensor, each.unit) for each in self._devices())

    def worn(self) -> tuple[Worn, ...]:
        """Return who wears the agent's devices."""
        return tuple(
            Worn.by(DeviceIdentity(each.sensor, each.unit, each.participant))
            for each in self._devices()
        )

    def streaming(self) -> frozenset[tuple[str, str]]:
        """Return the devices that stream, by sensor and unit."""
        state = State.STREAMING.value
        return frozenset((e.sensor, e.unit) for e in self._devices() if e.state == state)

    @property
    def is_virtual(self) -> bool:
        """Whether the agent's devices are virtual, and not in the settings."""
        return self._status is not None and self._status.virtual

    def sources(self) -> frozenset[str]:
        """Return the source_ids of the agent's streams."""
        return frozenset(source for device in self._devices() for source in device.streams)

    def device_facts(self) -> list[dict[str, Any]] | None:
        """Return the agent's devices as its status file has them; None if there is no agent."""
        if self.agent is AgentState.ABSENT:
            return None
        return [each.model_dump() for each in self._devices()]

    @property
    def agent_started_s(self) -> float | None:
        """When the agent began, as LSL time; None if there is none."""
        return None if self._status is None else self._status.started_s

    @property
    def lsl_session(self) -> str:
        """The LSL session of the agent; empty if there is none, or it is unknown."""
        return "" if self._status is None else self._status.session

    def _devices(self) -> Sequence[DeviceStatus]:
        return () if self._status is None else self._status.devices

    @property
    def can_be_one_persons(self) -> bool:
        """Whether one person can wear all enabled devices of the settings."""
        return not self.is_virtual and _can_be_one_persons(self.configured())

    def loaded(self) -> GatewaySettings:
        """Return the settings; the defaults if there is no file.

        Raises
        ------
        ConfigError
            If the file or an environment variable is wrong.
        """
        version = _version(self.settings)
        if self._loaded[0] != version or self._loaded[1] is None:
            outcome: GatewaySettings | ConfigError
            try:
                outcome = settings_file.load_or_defaults(self.settings, settings_models())
            except ConfigError as error:
                outcome = error
            self._loaded = version, outcome
        else:
            outcome = self._loaded[1]
        if isinstance(outcome, ConfigError):
            # Otherwise the traceback would grow each time that the error is raised.
            raise outcome.with_traceback(None)
        return outcome

    def status(self) -> StatusView:
        """Return the status of the agent, its devices, the recording and the replay."""
        status = self._status
        if self.agent is not AgentState.STARTING:
            self.told.set()
        facts = self._settings_facts()
        facts["recording"] = self.recording
        facts["replay"] = self.replay_view()
        facts["share"] = self.share
        facts["experiments"] = self.experiments
        if status is None:
            return StatusView(agent=self._absence(), **facts)
        return StatusView(
            **{name: value for name, value in status if name != "devices"},
            devices=self._viewer.devices(status, self.features),
            agent=AgentState.RUNNING,
            skipped=self._skipped,
            markers=self.markers,
            **facts,
        )

    def _absence(self) -> AgentState:
        is_coming = time.monotonic() - self._started_s < STARTING_S or is_held(self.folder)
        return AgentState.STARTING if is_coming else AgentState.ABSENT

    def _settings_facts(self) -> dict[str, Any]:
        problem, devices = "", ()
        try:
            devices = self.loaded().devices
        except ConfigError as error:
            problem = str(error)
        return {
            "settings_file": str(self.settings),
            "problem": problem,
            "configured": len(devices),
            "one_wearer": _can_be_one_persons(devices),
        }


def _can_be_one_persons(devices: Iterable[DeviceSettings]) -> bool:
    places = [(each.sensor_name, each.label) for each in devices if each.enabled]
    return 0 < len(places) == len(set(places))


def _version(path: Path) -> tuple[int, int, int] | str:
    try:
        stat = path.stat()
    except OSError as error:
        return str(error)
    return stat.st_mtime_ns, stat.st_size, stat.st_ino


_LOOK_S = 0.5
_FIRST_WINDOW_S = 60.0
"""Additional time for the first window: a browser that was just installed asks questions first."""
_GOODBYE_S, _HEARD_S = 1.0, 0.05
"""How long to wait until windows are notified of the end, and how often to check."""


class Shutdown:
    """Ends the server on request, or when it was not needed for a while.

    Parameters
    ----------
    after_s
        The server ends after this time in s without a window, an agent, a recording and a replay;
        infinite for never.
    """

    def __init__(self, session: Session, after_s: float = math.inf) -> None:
        self._session = session
        self._after_s = after_s
        self._asked = asyncio.Event()

    def request(self) -> None:
        """End the server soon, after the requests that are being answered."""
        self._asked.set()

    async def run(self) -> None:
        """Wait until the server is to end and all windows are notified."""
        await self._until_asked_or_not_needed()
        self._session.has_ended = True
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_GOODBYE_S):
                while self._session.traces.screens:  # noqa: ASYNC110 - each leaves by itself
                    await asyncio.sleep(_HEARD_S)

    async def _until_asked_or_not_needed(self) -> None:
        needed = time.monotonic() + _FIRST_WINDOW_S
        opened = 0
        while time.monotonic() - needed < self._after_s:
            # A window may have come and gone since the last look.
            if self._is_needed() or self._session.traces.opened != opened:
                needed = time.monotonic()
                opened = self._session.traces.opened
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), _LOOK_S)
                return

    def _is_needed(self) -> bool:
        session = self._session
        is_recording = session.recording.is_running or bool(session.recording.busy)
        has_window = bool(session.traces.screens)
        is_going_on = is_recording or session.replay_view().is_running
        return has_window or is_going_on or session.agent is not AgentState.ABSENT
