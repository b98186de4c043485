"""A virtual E4 streaming server to which a test does more than there are faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.devices.empatica_e4.simulator.e4 import Mishaps, Tear
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband


class SteeredE4(SimulatedE4):
    """What happens to a wristband, happens to the first where no other is named."""

    @property
    def requests(self) -> tuple[str, ...]:
        """Every line that clients sent, in order."""
        return self.world.call(lambda: tuple(self._commands.requests))

    @property
    def client_count(self) -> int:
        """Connections that stand."""
        return self.world.call(lambda: len(self._listener.clients))

    def press_button(self, device_id: str | None = None) -> None:
        """Tag a moment."""
        self._do(self._find(device_id).press_button)

    def turn_off(self, device_id: str | None = None) -> None:
        """Turn a wristband off by its button; clients are told and unbound."""
        self._do(lambda: self._turn_off(self._find(device_id)))

    def turn_on(self, device_id: str | None = None) -> None:
        """Turn a wristband on again."""
        self._do(lambda: self._turn_on(self._find(device_id)))

    def jump_clock(self, seconds: float) -> None:
        """Set the clock of the server's PC; the stamps jump with it."""
        self._do(lambda: self._jump_clock(seconds))

    def allow(self) -> None:
        """Register the first wristband to the owner of the key."""
        self._do(lambda: setattr(self._first, "is_allowed", True))
        self._do(lambda: self._attend((self._first,)))

    def refuse_stream(self, name: str) -> None:
        """Answer subscriptions to a stream with an error (``gsr``)."""
        self._do(lambda: self._manners.refused_streams.add(name))

    def withhold_reply(self, command: str) -> None:
        """Carry the next request of a command out without an answer."""
        self._do(lambda: self._manners.withheld.add(command))

    def never_answer(self, command: str, *, obey: bool) -> None:
        """Give no answer to a command, ever, whether or not it is carried out."""
        self._do(lambda: self._manners.never_answered.update({command: obey}))

    def empty_list(self, seconds: float) -> None:
        """List no wristband for so long; data go on."""
        loop, manners = self.world.loop, self._manners
        self._do(lambda: setattr(manners, "hides_all", True))
        self._do(lambda: loop.call_later(seconds, setattr, manners, "hides_all", False))

    def send_raw(self, data: bytes) -> None:
        """Send every client any bytes."""
        self._do(lambda: self._send_raw(data))

    def duplicate_line(self) -> None:
        """Write the next line of data twice."""
        self._befall(lambda mishaps: setattr(mishaps, "doubled", mishaps.doubled + 1))

    def glue_lines(self) -> None:
        """Write the next two lines of data as one; both count as never sent."""
        self._befall(lambda mishaps: setattr(mishaps, "glued", mishaps.glued + 1))

    def tear_line(self, pause_s: float = 0.2, *, in_line_end: bool = False) -> None:
        """Pause within the next line of data, in the middle or between CR and LF."""
        self._befall(lambda mishaps: mishaps.tears.append(Tear(pause_s, in_line_end)))

    def close_within_line(self) -> None:
        """Close the connection in the middle of the next line of data, which is lost."""
        self._befall(lambda mishaps: setattr(mishaps, "cut", mishaps.cut + 1))

    def close_connections(self) -> None:
        """Break every connection off with an RST; the port stays open."""
        self._do(self._listener.reset_all)

    def _turn_off(self, wristband: Wristband) -> None:
        was_connected = wristband.is_connected
        wristband.turn_off()
        if was_connected:
            self._tell(wristband, f"R device {wristband.device_id} turned off via button")
        for client in self._listener.clients:
            if client.bound_to == wristband.device_id:
                client.bind("")

    def _turn_on(self, wristband: Wristband) -> None:
        wristband.turn_on()
        self._attend((wristband,))

    def _jump_clock(self, seconds: float) -> None:
        self._clock.jump(seconds)
        for wristband in self._wristbands.values():
            wristband.stamps.jump(seconds)

    def _find(self, device_id: str | None) -> Wristband:
        return self._wristbands[device_id.lower()] if device_id else self._first

    def _befall(self, change: Callable[[Mishaps], None]) -> None:
        self._do(lambda: change(self._delivery.mishaps))

    def _do(self, action: Callable[[], Any]) -> None:
        self.world.call(action)
