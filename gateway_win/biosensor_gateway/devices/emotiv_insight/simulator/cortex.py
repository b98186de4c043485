"""A virtual Cortex service with a headset.

::

    with World() as world, SimulatedCortex(world, seed=1) as cortex:
        cortex.settings  # url, ca_file, headset
        cortex.client_id, cortex.client_secret
"""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from types import MappingProxyType
from typing import Any, Unpack

import numpy as np
import trustme

from biosensor_gateway.devices.emotiv_insight.simulator.account import (
    Account,
    App,
    Code,
    Sessions,
)
from biosensor_gateway.devices.emotiv_insight.simulator.headset import (
    INSIGHT_1,
    Announcement,
    Headset,
    Model,
    Release,
    Status,
    Timing,
    warning,
)
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Listener, server_context
from biosensor_gateway.devices.emotiv_insight.simulator.methods import (
    Manners,
    Methods,
    Replies,
    damaged_message,
)
from biosensor_gateway.devices.emotiv_insight.simulator.streams import Signals, Stage, Stream
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.truth import (
    NO_INTERVALS,
    TELLS_ITS_RATE,
    Contact,
    Expected,
    Gap,
)
from biosensor_gateway.simulation.virtual_device import Filled, Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World

APP = App("virtual-app", "virtual-secret-0123456789")
RELEASE = Release("4.8.32")


@dataclass(frozen=True)
class Circumstances:
    """Version, app and surroundings of a virtual Cortex."""

    release: Release = RELEASE
    app: App = APP
    neighbours: tuple[str, ...] = ()  # Ids of other headsets in the list.


_CORTEX_READY = 23
_GOING_AWAY = 1001
# Streams that are denied, one at a time.
_DENIABLE = ("eeg", "mot", "met", "dev", "pow")

EXPECTED = Expected(
    # Overall contact of all electrodes, in percent.
    contact=Contact("dev", 7),
    without_contact=("met",),
    # Cortex disconnects the headset, which then does not measure. Counters and times show the
    # exact loss.
    gaps={FaultKind.RESTART: Gap.STOPPED},
    impossible={FaultKind.REPEAT: NO_INTERVALS, Untidiness.RATE: TELLS_ITS_RATE},
)


class SimulatedCortex(VirtualDevice):
    """Cortex with one headset, on its own port of the loopback interface.

    Parameters
    ----------
    circumstances
        Version and app of Cortex, and further headsets.
    headset
        Headset id; None for ``A1B2C3D4`` after the model's prefix.
    model
        `INSIGHT_1`, `INSIGHT_1_GYRO` (older firmware) or `INSIGHT_2`.
    timing
        Durations of Cortex's actions.
    **specimen
        As for every virtual device: see `Specimen`. The drift is that of Cortex's clock.
    """

    sensor = "emotiv_insight"
    link = Link.WEB_SOCKET
    expected = EXPECTED
    filled = MappingProxyType({"gyro": Filled(None, "only headsets with older firmware have it")})
    client_id = APP.client_id
    client_secret = APP.client_secret

    def __init__(
        self,
        world: World,
        circumstances: Circumstances | None = None,
        *,
        headset: str | None = None,
        model: Model = INSIGHT_1,
        timing: Timing | None = None,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        seed = self.specimen.seed
        around = self._around = circumstances or Circumstances()
        self.client_id, self.client_secret = around.app
        self._model = model
        self._timing = timing or Timing()
        self._loop = world.loop
        self._rng = np.random.default_rng((seed, 0x6A))
        self._signals = Signals(model, self.specimen.wearer, seed)
        self._changes = 0
        self._obstacles: set[FaultKind] = set()
        self._tasks: list[asyncio.Task[None]] = []
        self._starting: asyncio.TimerHandle | None = None
        self._is_unreadable = False
        self._account = Account(around.app, seed)
        self._sessions = Sessions(seed)
        self._headset = Headset(
            headset or f"{model.prefix}-A1B2C3D4",
            model,
            self._timing,
            must_scan=around.release.must_scan,
            loop=self._loop,
            warn=self._tell_all,
        )
        self._manners = Manners()
        self._methods = methods = Methods(
            self._account,
            self._headset,
            self._sessions,
            around.release,
            around.neighbours,
            lambda stream: self._streams[stream].wake(),
        )
        self._to_deny = cycle(_DENIABLE)
        self._replies = Replies(methods, self._manners, self._loop)

    @property
    def settings(self) -> Mapping[str, Any]:
        """URL, certificate authority and headset id."""
        return {
            "url": f"wss://localhost:{self._listener.port}",
            "ca_file": str(self._ca_file),
            "headset": self._headset.headset_id,
        }

    @property
    def environment(self) -> Mapping[str, str]:
        """Credentials of the app as environment variables."""
        return {
            "EMOTIV_CLIENT_ID": self.client_id,
            "EMOTIV_CLIENT_SECRET": self.client_secret,
        }

    async def _start(self) -> None:
        authority = trustme.CA()
        self._folder = Path(tempfile.mkdtemp(prefix="virtual-cortex-"))
        self._ca_file = self._folder / "ca.pem"
        authority.cert_pem.write_to_path(self._ca_file)
        self._listener = Listener(
            server_context(authority), self._replies.hear, self._sessions.end_with
        )
        self._listener.open()
        self._begin_s = self.world.clock()
        self._unix_begin_s = time.time()
        self._oscillator = Oscillator(self.world.clock, self.specimen.drift_ppm, self._begin_s)
        self._streams = self._make_streams()
        self._tasks = [self._loop.create_task(stream.run()) for stream in self._streams.values()]

    async def _stop(self) -> None:
        if self._starting is not None:
            self._starting.cancel()
        self._headset.cancel()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._listener.stop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _make_streams(self) -> dict[str, Stream]:
        stage = Stage(
            oscillator=self._oscillator,
            begin_s=self._begin_s,
            jitter_s=self.specimen.jitter_s,
            rng=self._rng,
            truth=self.truth,
            delivers=lambda: self._headset.status is Status.CONNECTED,
            is_unreadable=lambda: self._is_unreadable,
            subscribed=self._sessions.subscribed,
            stamp=lambda device_s: self._unix_begin_s + device_s,
            changes=lambda: self._changes,
        )
        columns = self._around.release.columns
        return {
            name: Stream(name, rate, signal, columns(name, self._model), stage)
            for name, (rate, signal) in self._signals.sources().items()
        }

    def _tell_all(self, code: int, message: Announcement) -> None:
        self._send_raw(warning(code, message))

    def _send_raw(self, message: str | bytes) -> None:
        """Send a message to every client."""
        for client in tuple(self._listener.clients):
            client.send(message)

    def _send_garbage(self, count: float) -> None:
        for client in tuple(self._listener.clients):
            own = [session.session_id for session in self._sessions if session.client is client]
            for _ in range(round(count)):
                client.send(damaged_message(self._rng, own[0] if own else ""))

    def _break_links(self) -> None:
        self._listener.abort_all()

    def _refuse(self) -> None:
        self._break_links()
        self._manners.refusal = Code.INTERNAL

    def _comply(self) -> None:
        self._manners.refusal = None

    def _deny(self) -> None:
        self._methods.denied = frozenset({next(self._to_deny)})
        self._break_links()

    def _give(self) -> None:
        self._methods.denied = frozenset()

    def _send_unknown(self, messages: float) -> None:
        """Send every client messages of an unknown stream."""
        for _ in range(round(messages)):
            self._send_raw(json.dumps({"new": [1, 2], "sid": "", "time": 1700000000.5}))

    def _drop(self) -> None:
        self._obstruct(FaultKind.DROP)
        self._break_links()

    def _restore(self) -> None:
        self._clear_way(FaultKind.DROP)

    def _go_down(self) -> None:
        """End the process, which forgets tokens, sessions and the headset's connection."""
        self._obstruct(FaultKind.RESTART)
        self._listener.close_all(_GOING_AWAY)
        self._account.forget_tokens()
        self._sessions.forget()
        self._headset.reset()

    def _come_up(self) -> None:
        """Restart the process; it is ready shortly after its port is open."""
        self._manners.is_starting = True
        self._clear_way(FaultKind.RESTART)
        self._starting = self._loop.call_later(self._timing.starting_s, self._ready)

    def _ready(self) -> None:
        self._manners.is_starting = False
        self._tell_all(_CORTEX_READY, "Cortex is ready.")

    def _obstruct(self, reason: FaultKind) -> None:
        self._obstacles.add(reason)
        self._listener.shut()

    def _clear_way(self, reason: FaultKind) -> None:
        self._obstacles.discard(reason)
        if not self._obstacles:
            self._listener.open()

    def _discharge(self, percent: float) -> None:
        self._signals.battery_percent = round(percent)
        self._changes += 1

    def _take_off(self) -> None:
        self._signals.is_worn = False
        self._changes += 1

    def _put_on(self) -> None:
        self._signals.is_worn = True
        self._changes += 1

    def _drift(self, ppm: float) -> None:
        self._oscillator.set_drift(ppm)
        self._changes += 1

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_drop, _restore),
            FaultKind.GARBAGE: Effect(_send_garbage),
            FaultKind.REFUSE: lasting(_refuse, _comply),
            FaultKind.DENY: lasting(_deny, _give),
            Untidiness.STRAY: Effect(_send_unknown),
            FaultKind.LATE: level("_manners.late_s", 0.0, then=_break_links),
            FaultKind.UNREADABLE: flag("_is_unreadable"),
            FaultKind.RESTART: lasting(_go_down, _come_up),
            FaultKind.LOW_BATTERY: Effect(_discharge),
            FaultKind.OFF_BODY: lasting(_take_off, _put_on),
            FaultKind.DRIFT: Effect(_drift),
            **on_part("_listener", {FaultKind.STALL: lasting(Listener.stall, Listener.resume)}),
            **on_part("_sessions", {FaultKind.FORGET: Effect(Sessions.forget_subscriptions)}),
        }
    )
