"""A virtual E4 streaming server with wristbands, and what can happen to them.

::

    with World() as world, SimulatedE4(world, seed=1) as server:
        server.settings  # host, port, device
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from types import MappingProxyType
from typing import Any, Unpack

from biosensor_gateway.devices.empatica_e4.simulator.delivery import Mishaps, Tear
from biosensor_gateway.devices.empatica_e4.simulator.expected import EXPECTED
from biosensor_gateway.devices.empatica_e4.simulator.faults import EFFECTS
from biosensor_gateway.devices.empatica_e4.simulator.number_format import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.radio_link import Timing
from biosensor_gateway.devices.empatica_e4.simulator.server import Server
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband
from biosensor_gateway.simulation.effects import on_part
from biosensor_gateway.simulation.specimen import Specimen, SpecimenOptions
from biosensor_gateway.simulation.tcp_port import LOOPBACK
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.simulation.world import World


class SimulatedE4(VirtualDevice):
    """An E4 streaming server, on a port of its own, with one wristband or more.

    Faults and methods hit the first wristband where they do not name another.

    Parameters
    ----------
    world
        Where it lives.
    device_id
        Of the first wristband.
    others
        Ids of further ones; each has a wearer of another seed.
    automatic
        The server connects wristbands by itself, as its window has it by default;
        False: clients do, as where it was started without its window.
    allowed
        The first wristband is registered to the owner of the server's key.
    style
        Of numbers, after the Windows locale; a restart changes the decimal mark.
    timing
        When samples leave the wristbands; their jitter is ``jitter_s``.
    **specimen
        As for every virtual device: see `Specimen`. The drift is that of each wristband's crystal.
    """

    sensor = "empatica_e4"
    effects = MappingProxyType(on_part("_server", EFFECTS))
    expected = EXPECTED
    filled = MappingProxyType(
        {
            "hr": Filled(8, "the server sends it six seconds late"),
            "ibi": Filled(8, "the server sends it six seconds late"),
            "bat": Filled(11, "the server sends it every ten seconds"),
            "tag": Filled(None, "nobody presses the virtual wristband's button"),
            "gsr": Filled(2, "the server sends it in bursts"),
            "st": Filled(2, "the server sends it in bursts"),
        }
    )

    def __init__(
        self,
        world: World,
        *,
        device_id: str = "9ff167",
        others: Sequence[str] = (),
        automatic: bool = True,
        allowed: bool = True,
        style: NumberFormat | None = None,
        timing: Timing | None = None,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        timing = replace(timing or Timing(), jitter_s=self.specimen.jitter_s)
        self._server = Server(
            is_automatic=automatic,
            style=style or NumberFormat(),
            seed=self.specimen.seed,
            clock=world.clock,
        )
        for number, each in enumerate((device_id, *others)):
            own = _further(self.specimen, number) if number else self.specimen
            self._server.wristbands[each.lower()] = Wristband(
                each,
                own,
                timing,
                is_allowed=allowed or number > 0,
                truth=Truth(own.kept) if number else self.truth,
                deliver=self._server.delivery.deliver,
            )
        self._first = self._server.first

    @property
    def settings(self) -> Mapping[str, Any]:
        """Where it listens, which wristband."""
        return self.settings_of(self._first.device_id)

    def settings_of(self, device_id: str) -> Mapping[str, Any]:
        """Return what `settings` is for another wristband."""
        return {"host": LOOPBACK, "port": self._server.listener.port, "device": device_id}

    def truth_of(self, device_id: str) -> Truth:
        """Return what was sent on of one wristband."""
        return self._server.wristbands[device_id.lower()].truth

    @property
    def requests(self) -> tuple[str, ...]:
        """Every line that clients sent, in order."""
        return self.world.call(lambda: tuple(self._server.commands.requests))

    @property
    def client_count(self) -> int:
        """Connections that stand."""
        return self.world.call(lambda: len(self._server.listener.clients))

    def press_button(self, device_id: str | None = None) -> None:
        """Tag a moment."""
        self._do(self._find(device_id).press_button)

    def turn_off(self, device_id: str | None = None) -> None:
        """Turn a wristband off by its button; clients are told and unbound."""
        self._do(lambda: self._server.turn_off(self._find(device_id)))

    def turn_on(self, device_id: str | None = None) -> None:
        """Turn a wristband on again."""
        self._do(lambda: self._server.turn_on(self._find(device_id)))

    def lose_packets(self, share: float, seconds: float = inf) -> None:
        """Lose a share of the packets on the radio, from 0 to 1, for so long.

        The server numbers what arrives, so the stamps show no gap. HR and IBI, charge
        and tags are not lost: they bring their own time.
        """
        self._do(lambda: self._first.lose_packets(share, seconds))

    def jump_clock(self, seconds: float) -> None:
        """Set the clock of the server's PC; the stamps jump with it."""
        self._do(lambda: self._server.jump_clock(seconds))

    def allow(self) -> None:
        """Register the first wristband to the owner of the key."""
        self._do(lambda: setattr(self._first, "is_allowed", True))
        self._do(lambda: self._server.attend((self._first,)))

    def forbid(self) -> None:
        """Remove it from there; a radio link that stands is left alone."""
        self._do(lambda: setattr(self._first, "is_allowed", False))

    def refuse_stream(self, name: str) -> None:
        """Answer subscriptions to a stream with an error (``gsr``)."""
        self._do(lambda: self._server.manners.refused_streams.add(name))

    def withhold_reply(self, command: str) -> None:
        """Carry the next request of a command out without an answer."""
        self._do(lambda: self._server.manners.withheld.add(command))

    def never_answer(self, command: str, *, obey: bool) -> None:
        """Give no answer to a command, ever, whether or not it is carried out."""
        self._do(lambda: self._server.manners.never_answered.update({command: obey}))

    def empty_list(self, seconds: float) -> None:
        """List no wristband for so long; data go on."""
        loop, manners = self.world.loop, self._server.manners
        self._do(lambda: setattr(manners, "hides_all", True))
        self._do(lambda: loop.call_later(seconds, setattr, manners, "hides_all", False))

    def send_raw(self, data: bytes) -> None:
        """Send every client any bytes."""
        self._do(lambda: self._server.send_raw(data))

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
        self._do(self._server.listener.reset_all)

    async def _start(self) -> None:
        self._server.start()

    async def _stop(self) -> None:
        await self._server.stop()

    def _find(self, device_id: str | None) -> Wristband:
        return self._server.wristbands[device_id.lower()] if device_id else self._first

    def _befall(self, change: Callable[[Mishaps], None]) -> None:
        self._do(lambda: change(self._server.delivery.mishaps))

    def _do(self, action: Callable[[], Any]) -> None:
        self.world.call(action)


def _further(first: Specimen, number: int) -> Specimen:
    """Return one that somebody else wears."""
    return Specimen(
        seed=first.seed + number,
        drift_ppm=first.drift_ppm,
        jitter_s=first.jitter_s,
        kept=first.kept,
    )
