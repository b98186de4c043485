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
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Unpack, cast

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.headset import (
    INSIGHT_1,
    Announcement,
    Headset,
    Model,
    Release,
    Timing,
    warning,
)
from biosensor_gateway.devices.emotiv_insight.simulator.listener import (
    Authority,
    Client,
    Leaf,
    Listener,
)
from biosensor_gateway.devices.emotiv_insight.simulator.methods import (
    Account,
    App,
    Code,
    Licence,
    Methods,
    RpcError,
    Session,
    Sessions,
    User,
)
from biosensor_gateway.devices.emotiv_insight.simulator.streaming import (
    Mishaps,
    Signals,
    Stage,
    Stream,
)
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.effects import Effect, flag, lasting, level, on_part
from biosensor_gateway.simulation.expected import Contact, Expected, Gap
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.specimen import Specimen, SpecimenOptions
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.simulation.world import World

APP = App("virtual-app", "virtual-secret-0123456789")
RELEASE = Release("4.8.32")
_SUBSCRIPTION_DELAY_S = 0.3


@dataclass(frozen=True)
class Circumstances:
    """Its version, its user, its computer, and its manners.

    Attributes
    ----------
    release
        Version of Cortex.
    app
        The registered app.
    other_apps
        Secrets of further apps by client id; the user has approved them.
    user
        As they are at first.
    unlicensed_metrics_s
        Between two samples of ``met`` where the licence does not cover it [s].
    bluetooth_permitted
        False: the operating system keeps Cortex from Bluetooth.
    neighbours
        Ids of other headsets in the list.
    leaf, ca_without_key_usage
        What the server's certificate and that of its authority look like.
    reply_delays_s
        By method; answers overtake each other where these differ.
    data_before_reply
        Samples come before the reply to the subscription that asks for them.
    refusal_code
        Error of the fault REFUSE.
    """

    release: Release = RELEASE
    app: App = APP
    other_apps: Mapping[str, str] = field(default_factory=dict[str, str])
    user: User = field(default_factory=User)
    unlicensed_metrics_s: float = 10.0
    bluetooth_permitted: bool = True
    neighbours: tuple[str, ...] = ()
    leaf: Leaf = Leaf.VALID
    ca_without_key_usage: bool = False
    reply_delays_s: Mapping[str, float] = field(default_factory=dict[str, float])
    data_before_reply: bool = False
    refusal_code: int = Code.INTERNAL

    @property
    def secrets(self) -> dict[str, str]:
        """Secrets of all apps by client id."""
        return {**self.other_apps, self.app.client_id: self.app.client_secret}

    @property
    def approved_apps(self) -> set[str]:
        """Client ids of the apps that the user has approved."""
        return {*self.other_apps, *([self.app.client_id] if self.user.approved else [])}

    @property
    def delays_s(self) -> dict[str, float]:
        """How late each method is answered that is not answered at once [s]."""
        late = {"subscribe": _SUBSCRIPTION_DELAY_S} if self.data_before_reply else {}
        return late | dict(self.reply_delays_s)


_CORTEX_READY = 23
_GOING_AWAY = 1001

_STRANGER = "00000000-0000-0000-0000-000000000000"


def _damaged_message(rng: np.random.Generator, session_id: str) -> str | bytes:
    """One damaged message.

    Parameters
    ----------
    rng
        Chooses the kind of damage.
    session_id
        A session of the client that gets it, so that only the damage is wrong.
    """
    eeg: list[object] = [1, 0, 1, 1, 1, 1, 1, 0, 0, []]
    sample: dict[str, object] = {"eeg": eeg, "sid": session_id, "time": 1.0}
    intact = json.dumps(sample)
    return (
        intact[: len(intact) // 2],
        intact.replace("[1, 0, 1,", "[1, 0, NaN,"),
        json.dumps(sample | {"eeg": eeg[:4]}),
        json.dumps(sample | {"eeg": [1, 0, "x", *eeg[3:]]}),
        json.dumps({"eeg": eeg, "sid": session_id}),
        json.dumps(sample | {"sid": _STRANGER}),
        json.dumps({"xyz": [1], "sid": session_id, "time": 1.0}),
        json.dumps({"dev": 7, "sid": session_id, "time": 1.0}),
        json.dumps({"jsonrpc": "2.0"}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "result": {}}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "error": {"code": -32603}}),
        json.dumps({"jsonrpc": "2.0", "warning": "none"}),
        "[1,2,3]",
        "",
        rng.bytes(64),
    )[rng.integers(15)]


_KEPT_CALLS = 10_000
_REFUSED_METHODS = frozenset({"authorize", "createSession", "subscribe"})
_WITHOUT_BLUETOOTH = {"code": 31, "message": "Cortex may not use Bluetooth."}


@dataclass(slots=True)
class Manners:
    """How the server answers.

    Attributes
    ----------
    late_s
        Every answer is so late.
    delays_s
        Answers to a method are so much later still, and so may overtake each other.
    refusal
        Error code for whatever leads to data; None = not refused.
    is_starting
        Nothing but the version can be had yet.
    lacks_bluetooth
        The list of headsets carries the note that Bluetooth is not permitted.
    errors
        Codes for the next requests of a method.
    withheld, doubled
        Methods whose next request gets no answer, or two.
    """

    late_s: float = 0.0
    delays_s: Mapping[str, float] = field(default_factory=dict[str, float])
    refusal: int | None = None
    is_starting: bool = False
    lacks_bluetooth: bool = False
    errors: dict[str, deque[int]] = field(default_factory=dict[str, deque[int]])
    withheld: set[str] = field(default_factory=set[str])
    doubled: set[str] = field(default_factory=set[str])

    def check(self, method: str) -> None:
        """Refuse a request that is to be refused, before it has any effect.

        Raises
        ------
        RpcError
        """
        if self.is_starting and method != "getCortexInfo":
            raise RpcError(Code.STARTING, "Cortex is starting.")
        if self.refusal is not None and method in _REFUSED_METHODS:
            raise RpcError(self.refusal, "The request is refused.")
        if self.errors.get(method):
            raise RpcError(self.errors[method].popleft(), "The request has failed.")


class _Replies:
    """Reads requests, has them carried out and answers them.

    Parameters
    ----------
    loop
        For late answers.

    Attributes
    ----------
    calls
        Names of the methods that were asked for, in order.
    """

    def __init__(self, methods: Methods, manners: Manners, loop: asyncio.AbstractEventLoop) -> None:
        self.calls: deque[str] = deque(maxlen=_KEPT_CALLS)
        self._methods = methods
        self._manners = manners
        self._loop = loop

    def hear(self, client: Client, message: str | bytes) -> None:
        """Take one message of a client."""
        try:
            request = json.loads(message)
        except ValueError:
            self._answer(client, "", _failure(None, RpcError(Code.PARSE, "This is no JSON.")))
            return
        fields = cast("dict[str, Any]", request) if isinstance(request, dict) else {}
        method, reply = self._carry_out(client, fields)
        self._answer(client, method, reply)

    def _carry_out(self, client: Client, fields: dict[str, Any]) -> tuple[str, dict[str, Any]]:
        method, params = fields.get("method"), fields.get("params", {})
        if not isinstance(method, str) or not isinstance(params, dict):
            return "", _failure(fields.get("id"), RpcError(Code.INVALID_REQUEST, "No request."))
        self.calls.append(method)
        reply: dict[str, Any] = {"id": fields.get("id"), "jsonrpc": "2.0"}
        try:
            self._manners.check(method)
            reply["result"] = self._methods.call(method, client, cast("dict[str, Any]", params))
        except RpcError as error:
            return method, _failure(fields.get("id"), error)
        if method == "queryHeadsets" and self._manners.lacks_bluetooth:
            reply["attention"] = _WITHOUT_BLUETOOTH
        return method, reply

    def _answer(self, client: Client, method: str, reply: dict[str, Any]) -> None:
        manners = self._manners
        if method in manners.withheld:
            manners.withheld.remove(method)
            return
        delay_s = manners.late_s + manners.delays_s.get(method, 0.0)
        text = json.dumps(reply)
        for _ in range(2 if method in manners.doubled else 1):
            if delay_s:
                self._loop.call_later(delay_s, client.send, text)
            else:
                client.send(text)
        manners.doubled.discard(method)


def _failure(request_id: object, error: RpcError) -> dict[str, Any]:
    described = {"code": error.code, "message": error.message}
    return {"error": described, "id": request_id, "jsonrpc": "2.0"}


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
        self.replies = _Replies(methods, self.manners, self._loop)

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

    def send_garbage(self, count: float) -> None:
        """Send every client so many damaged messages."""
        for client in tuple(self.listener.clients):
            own = [session.session_id for session in self.sessions if session.client is client]
            for _ in range(round(count)):
                client.send(_damaged_message(self._rng, own[0] if own else ""))

    def log_in(self, *, is_logged_in: bool) -> None:
        """Log the user in or out; whoever logs out ends all sessions."""
        self.account.is_logged_in = is_logged_in
        if not is_logged_in:
            self.account.forget_tokens()
            self.sessions.lose_all()

    def break_links(self) -> None:
        """Break every connection off."""
        self.listener.abort_all()

    def refuse(self) -> None:
        """Break the connections off and refuse whatever leads to data."""
        self.break_links()
        self.manners.refusal = self._around.refusal_code

    def comply(self) -> None:
        """End that."""
        self.manners.refusal = None

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

    def set_battery(self, percent: float) -> None:
        """Set the charge of the headset's battery [percent]."""
        self._signals.battery_percent = round(percent)
        self._changes += 1

    def take_off(self) -> None:
        """Take the headset off."""
        self._signals.is_worn = False
        self._changes += 1

    def put_on(self) -> None:
        """Put it on again."""
        self._signals.is_worn = True
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


EXPECTED = Expected(
    # The contact of all electrodes together, in percent.
    contact=Contact("dev", 7),
    without_contact=("met",),
    # Cortex lets go of the headset, which then measures nothing. Its numbers and times tell
    # exactly what is lost.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)


class SimulatedCortex(VirtualDevice):
    """Cortex with one headset, on a port of its own on the loopback interface.

    Parameters
    ----------
    world
        Where it lives.
    circumstances
        Of the user, the computer and the version of Cortex.
    headset
        Id; None = ``A1B2C3D4`` after the model's prefix.
    model
        `INSIGHT_1`, `INSIGHT_1_GYRO` (older firmware), `INSIGHT_2`, `EPOC_X` or another.
    is_virtual
        The headset is one of the vendor's simulator: its end is never noticed.
    timing
        How long Cortex takes for what it does.
    **specimen
        As for every virtual device: see `Specimen`. The drift is that of the clock of Cortex.
    """

    sensor = "emotiv_insight"
    effects = MappingProxyType(
        {
            FaultKind.UNREADABLE: flag("_service.mishaps.unannounced"),
            **on_part(
                "_service.listener", {FaultKind.STALL: lasting(Listener.stall, Listener.resume)}
            ),
            **on_part(
                "_service.sessions", {FaultKind.FORGET: Effect(Sessions.forget_subscriptions)}
            ),
            **on_part(
                "_service",
                {
                    FaultKind.DROP: lasting(Service.drop, Service.restore),
                    FaultKind.GARBAGE: Effect(Service.send_garbage),
                    FaultKind.REFUSE: lasting(Service.refuse, Service.comply),
                    FaultKind.LATE: level("manners.late_s", 0.0, then=Service.break_links),
                    FaultKind.RESTART: lasting(Service.go_down, Service.come_up),
                    FaultKind.LOW_BATTERY: Effect(Service.set_battery),
                    FaultKind.OFF_BODY: lasting(Service.take_off, Service.put_on),
                    FaultKind.DRIFT: Effect(Service.set_drift),
                },
            ),
        }
    )
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
        is_virtual: bool = False,
        timing: Timing | None = None,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        circumstances = circumstances or Circumstances()
        self.client_id, self.client_secret = circumstances.app
        self._service = Service(
            Setup(
                circumstances=circumstances,
                headset_id=headset or f"{model.prefix}-A1B2C3D4",
                model=model,
                is_virtual=is_virtual,
                timing=timing or Timing(),
                specimen=self.specimen,
            ),
            self.truth,
            world,
        )

    @property
    def settings(self) -> Mapping[str, Any]:
        """Where it listens, what to trust, which headset."""
        return self._service.address()

    @property
    def environment(self) -> Mapping[str, str]:
        """Credentials of the app, as a driver looks for them."""
        return {
            "EMOTIV_CLIENT_ID": self.client_id,
            "EMOTIV_CLIENT_SECRET": self.client_secret,
        }

    async def _start(self) -> None:
        self._service.start()

    async def _stop(self) -> None:
        await self._service.stop()
