"""The server's process: its parts put together."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.conversation import (
    Client,
    Commands,
    Hear,
    Manners,
)
from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    NumberFormat,
    Packet,
    Sample,
    WallClock,
)
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband
from biosensor_gateway.simulation.tcp_port import TcpPort
from biosensor_gateway.system.clock import Clock

_STAMP = "1680442024,64479"
_DAMAGED: Sequence[bytes] = tuple(
    line.encode()
    for line in (
        "E4_Bvp 16804420",
        f"E4_Bvp {_STAMP}",
        f"E4_Bvp {_STAMP} NaN",
        f"E4_Bvp {_STAMP} -Infinity",
        f"E4_Acc {_STAMP} 1 2",
        f"E4_Gsr {_STAMP} 0,08 0,09",
        f"E4_Gsr {_STAMP} abc",
        "E4_Bvp 1680442024,64,479 1,0",
        f"E4_Foo {_STAMP} 1,0",
        f"E4_Bvp {_STAMP} 21,54169E4_Bvp 1680442024,66041 20,6037",
        "4479 21,5",
        "hello world",
        "R",
        "R device_frobnicate OK",
        "R device_list x",
        "R device_list 2 | 9ff167 Empatica_E4",
    )
)
_BROKEN_TEXT = b"E4\xff_Bvp 1680442024,6 1\xc3"
_FOREIGN = NumberFormat(decimal_mark="٫", digits="٠١٢٣٤٥٦٧٨٩")  # noqa: RUF001


def damaged_line(rng: np.random.Generator) -> bytes:
    """One damaged line, with its end."""
    kind = int(rng.integers(len(_DAMAGED) + 2))
    if kind < len(_DAMAGED):
        return _DAMAGED[kind] + b"\r\n"
    if kind == len(_DAMAGED):
        return _BROKEN_TEXT + b"\r\n"
    return rng.bytes(48).replace(b"\n", b"\0") + b"\r\n"


class Listener:
    """A TCP server whose port stays its own while it is shut.

    Parameters
    ----------
    hear
        Gets each client's requests.

    Attributes
    ----------
    clients
        Those that are connected.
    """

    def __init__(self, hear: Hear) -> None:
        self.clients: set[Client] = set()
        self._hear = hear
        self._port = TcpPort(self._connected)
        self._connecting: set[asyncio.Task[object]] = set()
        self._is_stalled = False

    @property
    def port(self) -> int:
        """TCP port, the same over all openings; 0 before the first."""
        return self._port.number

    def open(self) -> None:
        """Accept clients from now on.

        Raises
        ------
        TransportError
            BUSY if the port cannot be had.
        """
        self._port.open()

    def shut(self) -> None:
        """Refuse clients from now on, break off those that are connected, keep the port."""
        self._port.shut()
        self.reset_all()

    def reset_all(self) -> None:
        """Break every connection off."""
        for client in tuple(self.clients):
            client.reset()

    def stall(self) -> None:
        """Send and read nothing; connections stand, and new ones are taken."""
        self._is_stalled = True
        for client in self.clients:
            client.stall()

    def resume(self) -> None:
        """End a `stall`."""
        self._is_stalled = False
        for client in self.clients:
            client.resume()

    async def stop(self) -> None:
        """Close every connection and give the port back."""
        self._port.close()
        for client in tuple(self.clients):
            await client.end()

    def let_in(self, client: Client) -> bool:
        """Take a client, unless the port was shut since it was accepted."""
        if not self._port.is_open:
            return False
        self.clients.add(client)
        # In Python 3.11.2, which Debian 12 has, asyncio reads from a new connection although that
        # was paused as it was made, so it is paused right after.
        asyncio.get_running_loop().call_soon(self._stall_new, client)
        return True

    def _stall_new(self, client: Client) -> None:
        if self._is_stalled:
            client.stall()

    def let_go(self, client: Client) -> None:
        """Forget a client whose connection has ended."""
        self.clients.discard(client)

    def _connected(self, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        task = loop.create_task(
            loop.connect_accepted_socket(lambda: Client(self, self._hear), connection)
        )
        self._connecting.add(task)
        task.add_done_callback(self._connecting.discard)


class Server:
    """One server with its wristbands; everything runs in the world's loop.

    Parameters
    ----------
    is_automatic
        It connects wristbands by itself.
    style
        Of numbers, until a restart.
    seed
        Of garbage.
    clock
        The true time.

    Attributes
    ----------
    wristbands
        By id in small letters; to be filled before `start`.
    """

    def __init__(
        self,
        *,
        is_automatic: bool,
        style: NumberFormat,
        seed: int,
        clock: Clock,
    ) -> None:
        self._lsl = clock
        self.wristbands: dict[str, Wristband] = {}
        self.manners = Manners()
        self.commands = Commands(self.wristbands, self.manners, self._connect)
        self.listener = Listener(self.commands.hear)
        self.delivery = Delivery(lambda: self.listener.clients, style)
        self._is_automatic = is_automatic
        self._is_up = self._is_over = False
        self._rng = np.random.default_rng((seed, 0x6A))

    @property
    def first(self) -> Wristband:
        """The first wristband: the one that faults hit."""
        return next(iter(self.wristbands.values()))

    def start(self) -> None:
        """Open the port and, where the server does it, connect the wristbands."""
        self._clock = WallClock(self._lsl)
        for wristband in self.wristbands.values():
            wristband.begin(self._clock)
        self.come_up()

    async def stop(self) -> None:
        """Close everything; a restart that is under way comes to nothing."""
        self._is_over, self._is_up = True, False
        self._disconnect_all()
        await self.listener.stop()

    def come_up(self) -> None:
        """Start the process."""
        if self._is_over:
            return
        self._is_up = True
        self.listener.open()
        self.attend(self.wristbands.values())

    def go_down(self) -> None:
        """End the process; its successor runs under another locale."""
        self._is_up = False
        self.listener.shut()
        self._disconnect_all()
        self.delivery.style = self.delivery.style.with_other_mark()

    def attend(self, wristbands: Iterable[Wristband]) -> None:
        """Connect wristbands that can be, if the server does that by itself."""
        if not (self._is_automatic and self._is_up):
            return
        for each in wristbands:
            if each.is_advertising and each.is_allowed and not each.is_left_alone:
                self._connect(each)

    def lose(self, wristband: Wristband) -> None:
        """Let a wristband go out of the radio's reach, and tell its clients."""
        was_connected = wristband.is_connected
        wristband.lose()
        if was_connected:
            self._tell(wristband, f"R connection lost to device {wristband.device_id}")

    def come_back(self, wristband: Wristband) -> None:
        """Let it be in reach again."""
        wristband.come_back()
        self.attend((wristband,))

    def turn_off(self, wristband: Wristband) -> None:
        """Turn a wristband off by its button, tell its clients, and unbind them."""
        was_connected = wristband.is_connected
        wristband.turn_off()
        if was_connected:
            self._tell(wristband, f"R device {wristband.device_id} turned off via button")
        for client in self.listener.clients:
            if client.bound_to == wristband.device_id:
                client.bind("")

    def turn_on(self, wristband: Wristband) -> None:
        """Turn it on again."""
        wristband.turn_on()
        self.attend((wristband,))

    def forget_subscriptions(self) -> None:
        """Send no client any stream until it subscribes again; all stay bound."""
        for client in self.listener.clients:
            client.subscriptions.clear()

    def jump_clock(self, seconds: float) -> None:
        """Set the PC's clock, and the stamps with it."""
        self._clock.jump(seconds)
        for wristband in self.wristbands.values():
            wristband.stamps.jump(seconds)

    def send_raw(self, data: bytes) -> None:
        """Send every client any bytes."""
        for client in tuple(self.listener.clients):
            client.write(data)

    def send_garbage(self, count: int) -> None:
        """Send every client so many damaged lines."""
        for _ in range(count):
            self.send_raw(damaged_line(self._rng))

    def _connect(self, wristband: Wristband, patience_s: float = float("inf")) -> None:
        was_lost = wristband.is_lost
        wristband.connect(patience_s)
        if was_lost:
            self._tell(wristband, f"R connection re-established to device {wristband.device_id}")

    def _disconnect_all(self) -> None:
        for wristband in self.wristbands.values():
            wristband.disconnect()

    def _tell(self, wristband: Wristband, event: str) -> None:
        for client in tuple(self.listener.clients):
            if client.bound_to == wristband.device_id:
                client.write(f"{event}\n".encode())


@dataclass(frozen=True, slots=True)
class Tear:
    """How a line is torn.

    Attributes
    ----------
    pause_s
        Between the two parts.
    in_line_end
        Between CR and LF, else in the middle.
    """

    pause_s: float
    in_line_end: bool


@dataclass(slots=True)
class Mishaps:
    """What befalls the next lines of data; the numbers count down.

    Attributes
    ----------
    foreign
        Lines have the digits and marks of another script.
    doubled
        Are written twice.
    glued
        Pairs without a line end between them, which nobody can tell apart.
    tears
        One a line.
    cut
        Lines that end in the middle, and the connection with them.
    """

    foreign: bool = False
    doubled: int = 0
    glued: int = 0
    cut: int = 0
    tears: list[Tear] = field(default_factory=list[Tear])


class Delivery:
    """Takes what the wristbands send on to clients.

    Parameters
    ----------
    clients
        Who is connected.
    style
        How numbers are written.
    """

    def __init__(self, clients: Callable[[], Iterable[Client]], style: NumberFormat) -> None:
        self.mishaps = Mishaps()
        self.style = style
        self._clients = clients
        self._glue_to: bytes = b""

    def deliver(self, wristband: Wristband, packet: Packet) -> None:
        """Send a packet's lines to every client that wants them."""
        wanted = [
            client
            for client in tuple(self._clients())
            if client.wants(wristband.device_id, packet.subscription)
        ]
        if wristband.is_lost or wristband.loses(packet):
            if wanted:
                _note_unsent(wristband, packet.samples)
            return
        for sample in packet.samples:
            stamp_s = wristband.stamps.stamp(sample, packet.arrives_s)
            if wanted:
                style = _FOREIGN if self.mishaps.foreign else self.style
                self._send(wristband, sample, sample.line(stamp_s, style), wanted)

    def _send(
        self, wristband: Wristband, sample: Sample, line: bytes, wanted: list[Client]
    ) -> None:
        takers = [client for client in wanted if client.has_room]
        if not takers or self._is_to_be_spoilt or self.mishaps.foreign:
            # Noted before it is sent: what a client has read is in the truth.
            _note_unsent(wristband, (sample,))
            self._spoil(line, takers)
            return
        name, values = sample.stream.data_name, sample.declared_values
        wristband.truth.sent(name, (sample.measured_s,), (values,))
        if self.mishaps.doubled:
            self.mishaps.doubled -= 1
            line += line
        self._write(line, takers)

    def _write(self, line: bytes, takers: list[Client]) -> None:
        tears = self.mishaps.tears
        # One after the other: while a rest is held back, no other line is torn.
        is_next = bool(tears) and not any(client.is_holding for client in takers)
        tear = tears.pop(0) if is_next else None
        for client in takers:
            if tear is None:
                client.write(line)
            else:
                at = len(line) - 1 if tear.in_line_end else len(line) // 2
                client.write_torn(line, at, tear.pause_s)

    @property
    def _is_to_be_spoilt(self) -> bool:
        return bool(self._glue_to or self.mishaps.glued or self.mishaps.cut)

    def _spoil(self, line: bytes, takers: list[Client]) -> None:
        """Send what is left of a line that comes to nothing."""
        if not takers:
            return
        if self._glue_to:
            line, self._glue_to = self._glue_to + line, b""
        elif self.mishaps.glued:
            self.mishaps.glued -= 1
            self._glue_to = line.rstrip()
            return
        elif self.mishaps.cut:
            self.mishaps.cut -= 1
            line = line[: len(line) // 2]
        for client in takers:
            client.write(line)
            if not line.endswith(b"\n"):
                client.close()


def _note_unsent(wristband: Wristband, samples: tuple[Sample, ...]) -> None:
    for sample in samples:
        wristband.truth.unsent(sample.stream.data_name, 1)
