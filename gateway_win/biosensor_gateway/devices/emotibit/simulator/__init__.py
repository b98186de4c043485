"""A virtual EmotiBit in this computer's network."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, Unpack

import numpy as np

from biosensor_gateway.devices.emotibit.simulator import rounds
from biosensor_gateway.devices.emotibit.simulator.rounds import (
    ROUND_S,
    ROUNDS_EFFECTS,
    Host,
    Measured,
    Round,
    Rounds,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    Effects,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.tcp_port import LOOPBACK
from biosensor_gateway.simulation.truth import Expected, Gap, LossTolerance
from biosensor_gateway.simulation.virtual_device import Filled, Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World
from biosensor_gateway.system.clock import Clock

ACC_HZ = 25.0
# A host without a ping for this time is gone.
_FORGOTTEN_S = 10.0
_UNREACHABLE = frozenset({FaultKind.DROP, FaultKind.RESTART})

_UNAWARE = "nothing in it knows whether it is worn"

EXPECTED = Expected(
    by_agent=frozenset({"st"}),
    gaps={
        # Its clock restarts, so how long it was off is unknown.
        FaultKind.RESTART: Gap.UNKNOWN,
    },
    # Across a gap, samples are placed by reading times, which are up to a period late.
    loss_tolerance=LossTolerance(over_break=2),
    impossible={
        FaultKind.OFF_BODY: _UNAWARE,
        FaultKind.DENY: "it sends its measurements without a request",
        Untidiness.STRAY: "a foreign packet takes a packet number, so it counts as a loss",
        FaultKind.REPEAT: "each interval is sent once, in a packet with its own number",
    },
)

Address = tuple[str, int]


class _Wifi(asyncio.DatagramProtocol):
    """The advertising channel, and the quality of the Wi-Fi.

    Parameters
    ----------
    asked
        Called with each packet of a host and its address.
    host, port
        Address and UDP port for requests; port 0 takes a free one.
    """

    def __init__(
        self, asked: Callable[[rounds.Message, Address], None], host: str, port: int
    ) -> None:
        self._asked = asked
        self.host = host
        self._port = port
        self._transport: asyncio.DatagramTransport | None = None
        self._number = 0
        self.is_there = True
        self.to_lose = 0  # Number of data datagrams that will be lost.
        self.overtakes = False  # Whether every third datagram arrives after the next one.
        self._datagrams = 0
        self._overtaken: bytes | None = None

    @property
    def port(self) -> int:
        """The UDP port for requests."""
        if self._transport is None:
            raise RuntimeError("the virtual EmotiBit is not switched on")
        return int(self._transport.get_extra_info("sockname")[1])

    async def open(self) -> None:
        """Join the Wi-Fi."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, (self.host, self._port)
        )

    def close(self) -> None:
        """Leave the Wi-Fi."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def is_let_through(self) -> bool:
        """Return whether the next data datagram arrives."""
        if self.to_lose:
            self.to_lose -= 1
            return False
        return True

    def in_turn(self, datagram: bytes) -> list[bytes]:
        """Return the datagrams that arrive now: none, this one, or it and an overtaken one."""
        self._datagrams += 1
        overtaken, self._overtaken = self._overtaken, None
        if overtaken is not None:
            return [datagram, overtaken]
        if self.overtakes and self._datagrams % 3 == 0:
            self._overtaken = datagram
            return []
        return [datagram]

    def tell(self, time_ms: int, tag: str, payload: list[str], address: Address) -> None:
        """Send a packet to a host."""
        if self._transport is not None and self.is_there:
            self._transport.sendto(rounds.packet(time_ms, self._number, tag, payload), address)
            self._number += 1

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Pass on a host's packet; as in the firmware, each datagram has one."""
        if self.is_there:
            self._asked(rounds.heard(data.split(b"\n")[0]), (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Ignore errors that report a host as gone."""


def _overtake(wifi: _Wifi) -> None:
    wifi.overtakes = True


def _keep_order(wifi: _Wifi) -> None:
    wifi.overtakes = False


WIFI_EFFECTS: Effects[_Wifi] = MappingProxyType(
    {Untidiness.OVERTAKEN: lasting(_overtake, _keep_order)}
)


class OnItsWay(NamedTuple):
    """A datagram in transit, with its host and samples."""

    host: Host
    datagram: bytes
    samples: Sequence[Measured]


class _Sending:
    """Delivers datagrams after a delay, in order.

    Parameters
    ----------
    rng, jitter_s
        Random generator and maximum of the delays.
    """

    def __init__(
        self,
        clock: Clock,
        rng: np.random.Generator,
        jitter_s: float,
        put_out: Callable[[OnItsWay], None],
    ) -> None:
        self._clock, self._rng, self._jitter_s = clock, rng, jitter_s
        self._put_out = put_out
        self._pending: set[asyncio.TimerHandle] = set()
        self._waiting: deque[OnItsWay] = deque()
        self._until_s = 0.0

    def send(self, host: Host, datagram: bytes, samples: Sequence[Measured]) -> None:
        """Send one datagram."""
        delay_s = self._jitter_s * float(self._rng.random())
        self._until_s = max(self._until_s, self._clock() + delay_s)

        def arrive() -> None:
            self._pending.discard(timer)
            # Timers for the same moment run in any order, so the queue determines the datagram.
            self._put_out(self._waiting.popleft())

        self._waiting.append(OnItsWay(host, datagram, samples))
        loop = asyncio.get_running_loop()
        timer = loop.call_later(max(0.0, self._until_s - self._clock()), arrive)
        self._pending.add(timer)

    def forget(self) -> None:
        """Drop datagrams in transit."""
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        self._waiting.clear()
        self._until_s = 0.0


class SimulatedEmotiBit(VirtualDevice):
    """A virtual EmotiBit.

    Its `truth` contains what was sent to a connected host, with the times of measurement.

    Parameters
    ----------
    host, port
        Address and UDP port for requests; port 0 takes a free one. A real device uses 3131.
    ppg_hz
        Sampling rate of the pulse signal in its firmware.
    **specimen
        As for every virtual device: see `Specimen`. The drift is that of its processor's clock.
    """

    sensor = "emotibit"
    link = Link.UDP
    expected = EXPECTED
    rates_hz = MappingProxyType({"ppg": 25.0})
    filled = MappingProxyType(
        {
            "quality": Filled(None, "nothing is clipped"),
            "st": Filled(1, "the driver looks first which thermometers there are"),
        }
    )

    def __init__(
        self,
        world: World,
        *,
        device: str = "MD-V5-0000123",
        host: str = LOOPBACK,
        port: int = 0,
        ppg_hz: float = 25.0,
        battery_percent: float = 80.0,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self.device = device
        self._ppg_hz = self._rate_hz = ppg_hz
        self._acc_hz = ACC_HZ
        self._rng = np.random.default_rng(self.specimen.seed)
        self._battery_percent = battery_percent
        self._oscillator = Oscillator(world.clock, self.specimen.drift_ppm)
        self._worn_since_s = world.clock()
        self._rounds = self._switched_on()
        self._wifi = _Wifi(self._asked, host, port)
        self._host: Host | None = None
        self._running: asyncio.Task[None] | None = None
        self._sending = _Sending(world.clock, self._rng, self.specimen.jitter_s, self._put_out)
        self._answer_delay_s = 0.0
        self._stalled = self._refuses = self._sleeps = self._is_unreadable = False

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings ``host`` and ``port``."""
        return {"host": self._wifi.host, "port": self._wifi.port}

    @property
    def is_connected(self) -> bool:
        """Whether a host is connected."""
        return self._host is not None

    def lose(self, count: int) -> None:
        """Lose the next datagrams."""
        self.world.call(lambda: setattr(self._wifi, "to_lose", count))

    async def _start(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._worn_since_s = self.world.clock()
        self._rounds = self._switched_on()
        await self._wifi.open()
        self._running = asyncio.create_task(self._run())

    async def _stop(self) -> None:
        if self._running is not None:
            self._running.cancel()
        self._leave()
        self._wifi.close()

    def _switched_on(self) -> Rounds:
        rates_hz = self._rate_hz, self._acc_hz
        return Rounds(self._oscillator, self.specimen.wearer, self._worn_since_s, *rates_hz)

    async def _run(self) -> None:
        due_s = ROUND_S
        while True:
            await self._oscillator.reach(due_s)
            if self._host is not None and self.world.clock() - self._host.pinged_s > _FORGOTTEN_S:
                self._leave()
            made = self._rounds.next(due_s, self._battery_percent)
            self._send(made)
            due_s += ROUND_S

    def _send(self, made: Round) -> None:
        if self._host is None or self._sleeps:
            return
        place = 0
        for packets in rounds.datagrams(made.packets):
            inside = range(place, place + len(packets))
            samples = [made.samples[each] for each in inside if each in made.samples]
            self._sending.send(self._host, b"".join(packets), samples)
            place += len(packets)

    def _put_out(self, on_its_way: OnItsWay) -> None:
        host, datagram, samples = on_its_way
        if self._stalled or host is not self._host:
            return
        if self._is_unreadable:
            host.send(datagram.replace(b",", b";"))
            return
        is_sent = self._wifi.is_let_through() and all(map(host.send, self._wifi.in_turn(datagram)))
        for data_name, times, values in samples:
            if is_sent:
                note = self.truth.told if data_name == "bat" else self.truth.sent
                note(data_name, times, values)
            else:
                self.truth.unsent(data_name, len(times))

    def _asked(self, message: rounds.Message, address: tuple[str, int]) -> None:
        if not self._stalled:
            self.world.loop.call_later(self._answer_delay_s, self._answer, message, address)

    def _answer(self, message: rounds.Message, address: tuple[str, int]) -> None:
        match message.tag:
            case rounds.HELLO:
                port = self._host.data_port if self._host is not None else -1
                # A port other than the host's shows that another host uses it.
                port = 3132 if self._refuses else port
                self._tell(rounds.HERE, ["DP", str(port), "DI", self.device], address)
            case rounds.CONNECT if self._host is None and not self._refuses:
                control, data = message.behind("CP"), message.behind("DP")
                if control is not None and data is not None:
                    self._host = Host(
                        self._wifi.host, address[0], control, data, self._obey, self._leave
                    )
                    self._host.pinged_s = self.world.clock()
                    self._host.connect(lambda: self._tell_pong(address))
            case rounds.PING if self._host is not None:
                if message.behind("DP") == self._host.data_port:
                    self._host.pinged_s = self.world.clock()
                    self._tell_pong(address)
            case _:
                return

    def _tell_pong(self, address: tuple[str, int]) -> None:
        if self._host is not None:
            self._tell(rounds.PONG, ["DP", str(self._host.data_port)], address)

    def _tell(self, tag: str, payload: list[str], address: tuple[str, int]) -> None:
        if not self._stalled:
            self._wifi.tell(int(self._oscillator.now() * 1000), tag, payload, address)

    def _obey(self, message: rounds.Message) -> None:
        """Execute a host's command, or record its time message."""
        if self._stalled:
            return
        match message.tag:
            case rounds.DISCONNECT:
                self._leave()
            case rounds.NORMAL_POWER:
                self._sleeps = False
            case mode if mode in rounds.QUIET:
                self._sleeps = True
            case rounds.TIME_LOCAL | rounds.TIME_UTC | rounds.ACKNOWLEDGED:
                if self._host is not None:
                    noted = self._rounds.note(message.tag, list(message.payload))
                    self._sending.send(self._host, noted, ())
            case _:
                return

    def _leave(self) -> None:
        self._sending.forget()
        if self._host is not None:
            self._host.close()
            self._host = None

    def _vanish(self) -> None:
        self._leave()
        self._wifi.is_there = False

    def _return(self) -> None:
        self._wifi.is_there = not _UNREACHABLE & self._lasting.keys()

    def _power_cycle(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._rounds = self._switched_on()
        self._sleeps = False
        if self._running is not None:
            self._running.cancel()
        self._running = asyncio.create_task(self._run())
        self._return()

    def _babble(self, count: float) -> None:
        if self._host is not None:
            self._host.send(self._rng.bytes(int(count)))

    def _change_rate(self, hz: float) -> None:
        self._rate_hz = hz
        self._vanish()
        self._power_cycle()

    def _usual_rate(self) -> None:
        self._change_rate(self._ppg_hz)

    def _change_pace(self, percent: float) -> None:
        self._acc_hz = ACC_HZ * (1 + percent / 100)
        self._vanish()
        self._power_cycle()

    def _usual_pace(self) -> None:
        self._change_pace(0.0)

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_vanish, _return),
            FaultKind.RESTART: lasting(_vanish, _power_cycle),
            FaultKind.STALL: flag("_stalled"),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.REFUSE: flag("_refuses", then=_leave),
            FaultKind.LATE: level("_answer_delay_s", 0.0, then=_leave),
            FaultKind.FORGET: flag("_sleeps"),
            FaultKind.UNREADABLE: flag("_is_unreadable"),
            FaultKind.LOW_BATTERY: level("_battery_percent"),
            **on_part("_oscillator", {FaultKind.DRIFT: Effect(Oscillator.set_drift)}),
            **on_part("_rounds", ROUNDS_EFFECTS),
            **on_part("_wifi", WIFI_EFFECTS),
            Untidiness.RATE: Effect(_change_rate, _usual_rate),
            Untidiness.PACE: Effect(_change_pace, _usual_pace),
        }
    )
