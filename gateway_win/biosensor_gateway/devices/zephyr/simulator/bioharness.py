"""A virtual BioHarness 3 on a serial port, with any source of packets.

It is silent before the host's first byte, always measures, and forgets the host's settings when
the host disconnects or is silent for too long.
"""

from __future__ import annotations

import asyncio
import sys
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from types import MappingProxyType
from typing import Any, Protocol, Unpack

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator.wire import (
    REQUESTS,
    DeviceStamp,
    Packet,
    Request,
    RequestReader,
    Values,
    frame,
    response,
    with_wrong_check,
)
from biosensor_gateway.simulation.async_serial import AsyncSerialPort, serial_port
from biosensor_gateway.simulation.faults import Effect, FaultKind, Untidiness, flag, glued, lasting
from biosensor_gateway.simulation.virtual_device import Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import Clock

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Outgoing:
    """One frame of a source, with its contents."""

    data: bytes  # The frame's bytes, or recorded invalid bytes.
    packet: Packet | None = None  # Its kind; None for invalid bytes and unknown message ids.
    # Packet number since power-on, not wrapped; the frame contains its low 8 bits.
    sequence: int | None = None
    stamp: DeviceStamp | None = None  # The device's time in the frame.
    measured_at: float | None = None  # LSL time of its first sample, or of the whole summary [s].
    period_s: float | None = None  # True sample period [s].
    first_index: int | None = None  # Number of its first sample since power-on.
    samples: Integers | None = None  # Shape (samples, channels); as from `Inputs.samples`.
    values: Values | None = None  # Fields of a summary or general data packet.


class Source(Protocol):
    """Provides frames when due; all times are LSL times in seconds."""

    @property
    def speaks_lifesigns(self) -> bool:
        """Whether its frames currently include the device's lifesigns."""
        ...

    def power_on(self, clock: Clock) -> None:
        """Start measuring with this clock."""
        ...

    def poll(self, now: float, enabled: frozenset[Packet]) -> Iterable[Outgoing]:
        """Return the frames that are due; periodic packets only if enabled."""
        ...

    def next_due(self) -> float:
        """Return when to call `poll` again."""
        ...

    def hangs_up(self, now: float) -> bool:
        """Whether the device ends the connection by itself."""
        ...

    def connection_ended(self) -> None:
        """Note that the host is gone."""
        ...


_BUFFER_BYTES = 4096
_DRAIN_CHECK_S = 0.02
_HANG_UP_S = 1.0
_UNREACHABLE = frozenset({FaultKind.DROP, FaultKind.RESTART})

# The session has no I/O: bytes and the time come in, bytes go out.
_SWITCH_VALUES = (b"\0", b"\1")
_SUMMARY_PERIODS = (b"\0\0", b"\1\0")


@dataclass
class Session:
    """One host's connection, with the packets that it has enabled."""

    summary_supported: bool = True  # False for firmware with general data (0x20) only.
    # Silence after which a host is disconnected; None for never.
    host_timeout_s: float | None = 10.0
    lifesign_s: float = 3.0  # Interval of the device's lifesigns.
    answer_delay_s: float = 0.0
    # refused, ignored: request ids that get a NAK or no answer; neither has any effect.
    refused: set[int] = field(default_factory=set[int])
    ignored: set[int] = field(default_factory=set[int])

    def __post_init__(self) -> None:
        self._reader = RequestReader()
        self._enabled: frozenset[Packet] = frozenset()
        self._answers: deque[tuple[float, bytes]] = deque()
        self._heard_at: float | None = None
        self._lifesign_at = inf

    @property
    def enabled(self) -> frozenset[Packet]:
        """The periodic packets that the host has enabled."""
        return self._enabled

    @property
    def active(self) -> bool:
        """Whether the host has sent anything on this connection."""
        return self._heard_at is not None

    def hear(self, data: bytes, now: float) -> list[Request]:
        """Process the host's bytes at ``now`` [s]; return the requests in them."""
        if self._heard_at is None:
            self._lifesign_at = now + self.lifesign_s
        self._heard_at = now
        requests = self._reader.feed(data, now)
        for request in requests:
            self._obey(request, now)
        return requests

    def say(self, now: float) -> list[bytes]:
        """Return the answers and the lifesign that are due at ``now`` [s]."""
        frames: list[bytes] = []
        while self._answers and self._answers[0][0] <= now:
            frames.append(self._answers.popleft()[1])
        if self._lifesign_at <= now:
            self._lifesign_at = now + self.lifesign_s
            frames.append(frame(Packet.LIFESIGN))
        return frames

    def next_due(self) -> float:
        """Return when to send something or to disconnect the host [s]."""
        answer = self._answers[0][0] if self._answers else inf
        return min(answer, self._lifesign_at, self._drop_at())

    def host_is_lost(self, now: float) -> bool:
        """Whether the host has been silent for too long."""
        return self._drop_at() <= now

    def forget_enables(self) -> None:
        """Forget the enabled packets but keep the connection."""
        self._enabled = frozenset()

    def forget(self) -> None:
        """End the connection, without enabled packets or pending answers."""
        self.__post_init__()

    def _drop_at(self) -> float:
        if self._heard_at is None or self.host_timeout_s is None:
            return inf
        return self._heard_at + self.host_timeout_s

    def _obey(self, request: Request, now: float) -> None:
        request_id = request.request_id
        if request_id in self.ignored or (request_id == Packet.LIFESIGN and request.intact):
            return
        accepted = self._is_acceptable(request)
        if accepted:
            packet = REQUESTS[request_id]
            self._enabled = (
                self._enabled | {packet} if any(request.payload) else self._enabled - {packet}
            )
        self._answers.append((now + self.answer_delay_s, response(request_id, accepted=accepted)))

    def _is_acceptable(self, request: Request) -> bool:
        packet = REQUESTS.get(request.request_id)
        if not request.intact or packet is None or request.request_id in self.refused:
            return False
        if packet is Packet.SUMMARY:
            return self.summary_supported and request.payload in _SUMMARY_PERIODS
        return request.payload in _SWITCH_VALUES


class BioHarness(VirtualDevice):
    """A source of packets, a session and a port, with the faults of the link.

    Parameters
    ----------
    session
        Command session; that of new firmware by default.
    buffer_bytes
        Size of the radio's buffer for a host that does not read.
    tcp
        Use a TCP server instead of a pseudo-terminal; default on systems without one.
    **specimen
        As for every virtual device: see `Specimen`. Wearer, drift and jitter belong to the source.
    """

    sensor = "zephyr"
    link = Link.SERIAL

    def __init__(
        self,
        world: World,
        source: Source,
        session: Session | None = None,
        *,
        buffer_bytes: int = _BUFFER_BYTES,
        tcp: bool = sys.platform == "win32",
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        # source, session: may only be changed in the world's event loop.
        self.source = source
        self.session = session or Session()
        self._rng = np.random.default_rng(self.specimen.seed)
        self._buffer_bytes = buffer_bytes
        self._tcp = tcp
        self._port: AsyncSerialPort | None = None
        self._stalled = self._garbled = False
        self._unheard = bytearray()
        self._next_turn: asyncio.TimerHandle | None = None
        self._reopening: asyncio.TimerHandle | None = None

    @property
    def port(self) -> str:
        """Name of its serial port for the host; it stays the same after lost links."""
        if self._port is None:
            raise RuntimeError("the virtual BioHarness is not switched on")
        return self._port.name

    @property
    def settings(self) -> Mapping[str, Any]:
        """The setting ``port``."""
        return {"port": self.port}

    async def _start(self) -> None:
        self._port = serial_port(
            self._heard, self._link_lost, buffer_bytes=self._buffer_bytes, tcp=self._tcp
        )
        self._port.open()
        self.source.power_on(self.world.clock)
        self._take_turn()

    async def _stop(self) -> None:
        for timer in (self._next_turn, self._reopening):
            if timer is not None:
                timer.cancel()
        if self._port is not None:
            self._port.dispose()

    def _note(self, frame: Outgoing, *, sent: bool) -> None:
        """Record a frame that was due and enabled, and whether it was sent."""

    def _heard(self, data: bytes) -> None:
        if self._stalled:
            # RFCOMM is reliable, so the host's data wait in the radio meanwhile.
            self._unheard += data
            return
        self.session.hear(data, self.world.clock())
        self._take_turn()

    def _take_turn(self) -> None:
        """Send what is due, and schedule the next turn."""
        now = self.world.clock()
        if self.session.host_is_lost(now):
            self._link_lost()
        self._speak(now)
        self._hang_up_if_over(now)
        if self._next_turn is not None:
            self._next_turn.cancel()
        due_s = self._next_due(now)
        self._next_turn = (
            self.world.loop.call_later(max(0.0, due_s - now), self._take_turn)
            if isfinite(due_s)
            else None
        )

    def _next_due(self, now: float) -> float:
        if self.source.hangs_up(now):
            return now + _DRAIN_CHECK_S
        return min(self.session.next_due(), self.source.next_due())

    def _speak(self, now: float) -> None:
        for data in self.session.say(now):
            if data[1] != Packet.LIFESIGN or not self.source.speaks_lifesigns:
                self._write(data)
        for due in self.source.poll(now, self.session.enabled):
            if self._garbled:
                self._write(with_wrong_check(due.data))
            self._note(due, sent=not self._garbled and self._write(due.data))

    def _write(self, data: bytes) -> bool:
        reaches_host = self._port is not None and self.session.active and not self._stalled
        return reaches_host and self._port is not None and self._port.write(data)

    def _hang_up_if_over(self, now: float) -> None:
        if self._port is not None and self.source.hangs_up(now) and self._port.drained():
            self._hang_up()
            self._reopening = self.world.loop.call_later(_HANG_UP_S, self._reopen)

    def _hang_up(self) -> None:
        self._link_lost()
        if self._port is not None:
            self._port.hang_up()

    def _reopen(self) -> None:
        if self._port is not None and not _UNREACHABLE & self._lasting.keys():
            self._port.open()

    def _link_lost(self) -> None:
        self._unheard.clear()
        self.session.forget()
        self.source.connection_ended()

    def _stall(self) -> None:
        self._stalled = True

    def _resume(self) -> None:
        self._stalled = False
        if self._unheard:
            data = bytes(self._unheard)
            self._unheard.clear()
            self._heard(data)

    def _babble(self, count: float) -> None:
        self._write(self._rng.bytes(int(count)))

    effects = MappingProxyType(
        {
            Untidiness.GLUED: glued("_port"),
            FaultKind.DROP: lasting(_hang_up, _reopen),
            FaultKind.STALL: lasting(_stall, _resume),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.UNREADABLE: flag("_garbled"),
        }
    )
