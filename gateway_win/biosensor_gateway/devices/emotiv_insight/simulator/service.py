"""The Cortex process: its parts put together."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.account import Account, Licence
from biosensor_gateway.devices.emotiv_insight.simulator.certificates import Authority
from biosensor_gateway.devices.emotiv_insight.simulator.circumstances import Circumstances
from biosensor_gateway.devices.emotiv_insight.simulator.garbage import damaged_message
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Headset, Timing
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client, Listener
from biosensor_gateway.devices.emotiv_insight.simulator.methods import Methods
from biosensor_gateway.devices.emotiv_insight.simulator.mishaps import Mishaps
from biosensor_gateway.devices.emotiv_insight.simulator.models import Model
from biosensor_gateway.devices.emotiv_insight.simulator.replies import Manners, Replies
from biosensor_gateway.devices.emotiv_insight.simulator.sessions import Session, Sessions
from biosensor_gateway.devices.emotiv_insight.simulator.signals import Signals
from biosensor_gateway.devices.emotiv_insight.simulator.streaming import Stage, Stream
from biosensor_gateway.devices.emotiv_insight.simulator.warnings import Announcement, warning
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.specimen import Specimen
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.world import World

_CORTEX_READY = 23
_GOING_AWAY = 1001


@dataclass(frozen=True, slots=True)
class Setup:
    """How a virtual Cortex begins; the fields are those of `SimulatedCortex`."""

    circumstances: Circumstances
    headset_id: str
    model: Model
    is_virtual: bool
    timing: Timing
    specimen: Specimen


class Service:
    """Account, headset, sessions, streams and server of one Cortex.

    Everything runs in the world's loop.

    Parameters
    ----------
    setup
    truth
        Where the streams note what they sent.
    world
        Where it runs.
    """

    def __init__(self, setup: Setup, truth: Truth, world: World) -> None:
        self._setup = setup
        self._around = setup.circumstances
        self._truth = truth
        self._loop = world.loop
        self._clock = world.clock
        self._rng = np.random.default_rng((setup.specimen.seed, 0x6A))
        self._signals = Signals(setup.model, setup.specimen.wearer, setup.specimen.seed)
        self._changes = 0
        self._obstacles: set[str] = set()
        self._tasks: list[asyncio.Task[None]] = []
        self._starting: asyncio.TimerHandle | None = None
        self.mishaps = Mishaps()
        self.account = Account(
            self._around.secrets,
            self._around.approved_apps,
            self._around.user,
            seed=setup.specimen.seed,
        )
        self.sessions = Sessions(self._warn_one, setup.specimen.seed)
        self.headset = Headset(
            setup.headset_id,
            setup.model,
            setup.timing,
            is_virtual=setup.is_virtual,
            must_scan=self._around.release.must_scan,
            loop=self._loop,
            warn=self.warn,
            lost=self.sessions.lose_all,
        )
        self.manners = Manners(
            delays_s=self._around.delays_s, lacks_bluetooth=not self._around.bluetooth_permitted
        )
        methods = Methods(
            self.account,
            self.headset,
            self.sessions,
            self._around.release,
            self._around.neighbours,
            self._subscribed,
        )
        self.replies = Replies(methods, self.manners, self._loop)

    @property
    def eeg_rate(self) -> int:
        """EEG samples a second."""
        return self._setup.model.eeg_rate

    def start(self) -> None:
        """Open the port and let the headset measure."""
        authority = Authority(has_key_usage=not self._around.ca_without_key_usage)
        self._folder = Path(tempfile.mkdtemp(prefix="virtual-cortex-"))
        self._ca_file = self._folder / "ca.pem"
        self._ca_file.write_bytes(authority.pem)
        self.listener = Listener(
            authority.server_context(self._around.leaf), self.replies.hear, self.sessions.end_with
        )
        self.listener.open()
        self._begin_s = self._clock()
        self._unix_begin_s = time.time()
        self._crystal = Crystal(self._clock, self._setup.specimen.drift_ppm, self._begin_s)
        self._streams = self._make_streams()
        self._tasks = [self._loop.create_task(stream.run()) for stream in self._streams.values()]

    async def stop(self) -> None:
        """Close everything and remove the certificate's file."""
        if self._starting is not None:
            self._starting.cancel()
        self.headset.cancel()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.listener.stop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def address(self) -> dict[str, str]:
        """Return the fields of a driver's settings that lead here."""
        return {
            "url": f"wss://localhost:{self.listener.port}",
            "ca_file": str(self._ca_file),
            "headset": self._setup.headset_id,
        }

    def warn(self, code: int, message: Announcement) -> None:
        """Tell every client of a warning."""
        self.send_raw(warning(code, message))

    def send_raw(self, message: str | bytes | Sequence[str]) -> None:
        """Send every client a message, a sequence of texts in as many frames."""
        if not isinstance(message, str | bytes):
            self.listener.send_in_pieces(message)
            return
        for client in tuple(self.listener.clients):
            client.send(message)

    def send_garbage(self, count: int) -> None:
        """Send every client so many damaged messages."""
        for client in tuple(self.listener.clients):
            own = [session.session_id for session in self.sessions if session.client is client]
            for _ in range(count):
                client.send(damaged_message(self._rng, own[0] if own else ""))

    def log_in(self, *, is_logged_in: bool) -> None:
        """Log the user in or out; whoever logs out ends all sessions."""
        self.account.is_logged_in = is_logged_in
        if not is_logged_in:
            self.account.forget_tokens()
            self.sessions.lose_all()

    def refuse(self) -> None:
        """Break the connections off and refuse whatever leads to data."""
        self.listener.abort_all()
        self.manners.refusal = self._around.refusal_code

    def delay(self, seconds: float) -> None:
        """Break the connections off and answer late."""
        self.listener.abort_all()
        self.manners.late_s = seconds

    def drop(self) -> None:
        """Be unreachable."""
        self._obstruct("drop")
        self.listener.abort_all()

    def restore(self) -> None:
        """End a `drop`."""
        self._clear_way("drop")

    def go_down(self) -> None:
        """End the process: tokens, sessions and the headset's connection are forgotten."""
        self._obstruct("restart")
        self.listener.close_all(_GOING_AWAY)
        self.account.forget_tokens()
        self.sessions.forget()
        self.headset.reset()

    def come_up(self) -> None:
        """Start the process again; it is ready a little after its port is open."""
        self.manners.is_starting = True
        self._clear_way("restart")
        self._starting = self._loop.call_later(self._setup.timing.starting_s, self._ready)

    def set_battery(self, percent: int) -> None:
        """Set the charge of the headset's battery [percent]."""
        self._signals.battery_percent = percent
        self._changes += 1

    def set_worn(self, *, is_worn: bool) -> None:
        """Put the headset on or take it off."""
        self._signals.is_worn = is_worn
        self._changes += 1

    def set_drift(self, ppm: float) -> None:
        """Let the clock of Cortex run at another speed from now on."""
        self._crystal.set_drift(ppm)
        self._changes += 1

    def step_clock(self, seconds: float) -> None:
        """Set the clock of Cortex forward or back."""
        self._unix_begin_s += seconds

    def _make_streams(self) -> dict[str, Stream]:
        setup = self._setup
        stage = Stage(
            crystal=self._crystal,
            begin_s=self._begin_s,
            jitter_s=setup.specimen.jitter_s,
            rng=self._rng,
            truth=self._truth,
            delivers=lambda: self.headset.delivers,
            subscribed=self.sessions.subscribed,
            is_due=self._is_due,
            stamp=lambda device_s: self._unix_begin_s + device_s,
            changes=lambda: self._changes,
        )
        return {
            name: Stream(
                name,
                rate,
                signal,
                self._around.release.columns(name, setup.model),
                self.mishaps,
                stage,
            )
            for name, (rate, signal) in self._signals.sources().items()
        }

    def _subscribed(self, stream: str) -> None:
        self._streams[stream].wake()

    def _is_due(self, session: Session, stream: str, number: int) -> bool:
        if stream != "met" or (session.is_active and Licence.METRICS in self.account.licence):
            return True
        rate, _ = self._signals.sources()[stream]
        return number % round(self._around.unlicensed_metrics_s * rate) == 0

    def _obstruct(self, reason: str) -> None:
        self._obstacles.add(reason)
        self.listener.shut()

    def _clear_way(self, reason: str) -> None:
        self._obstacles.discard(reason)
        if not self._obstacles:
            self.listener.open()

    def _ready(self) -> None:
        self.manners.is_starting = False
        self.warn(_CORTEX_READY, "Cortex is ready.")

    def _warn_one(self, client: Client, code: int, message: Announcement) -> None:
        client.send(warning(code, message))
