"""The server's process: its parts put together."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.commands import Commands, Manners
from biosensor_gateway.devices.empatica_e4.simulator.delivery import Delivery
from biosensor_gateway.devices.empatica_e4.simulator.garbage import damaged_line
from biosensor_gateway.devices.empatica_e4.simulator.listener import Listener
from biosensor_gateway.devices.empatica_e4.simulator.number_format import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.wall_clock import WallClock
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband
from biosensor_gateway.system.clock import Clock


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
    listener, delivery, commands, manners
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

    def refuse(self) -> None:
        """Break the connections off and let nobody bind."""
        self.manners.refuses_binding = True
        self.listener.reset_all()

    def answer_late(self, seconds: float) -> None:
        """Break the connections off and answer late."""
        self.manners.late_s = seconds
        self.listener.reset_all()

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
