"""A virtual E4 streaming server with wristbands.

::

    with World() as world, SimulatedE4(world, seed=1) as server:
        server.settings  # host, port, device
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from types import MappingProxyType
from typing import Any, Unpack

from biosensor_gateway.devices.empatica_e4.simulator.server import Listener, Server
from biosensor_gateway.devices.empatica_e4.simulator.wire import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Timing, Wristband
from biosensor_gateway.simulation.effects import Effect, flag, lasting, level, on_part
from biosensor_gateway.simulation.expected import Expected, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.specimen import Specimen, SpecimenOptions
from biosensor_gateway.simulation.tcp_port import LOOPBACK
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.simulation.world import World

EXPECTED = Expected(
    without_contact=("gsr",),
    by_agent=frozenset({"quality"}),
    # A loss is a time, told to 0.05 s, and some samples come six at a time.
    loss_tolerance=LossTolerance(always={"bvp": 4, "acc": 2, "gsr": 6, "st": 6}),
)

_DENIABLE = ("bvp", "acc", "gsr", "tmp")


class SimulatedE4(VirtualDevice):
    """An E4 streaming server, on a port of its own, with one wristband or more.

    Faults hit the first wristband.

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
        self._to_deny = cycle(_DENIABLE)

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

    async def _start(self) -> None:
        self._server.start()

    async def _stop(self) -> None:
        await self._server.stop()

    def _break_links(self) -> None:
        self._server.listener.reset_all()

    def _lose(self) -> None:
        self._server.lose(self._first)

    def _come_back(self) -> None:
        self._server.come_back(self._first)

    def _babble(self, lines: float) -> None:
        self._server.send_garbage(round(lines))

    def _deny(self) -> None:
        self._server.manners.refused_streams.add(next(self._to_deny))
        self._break_links()

    def _give(self) -> None:
        self._server.manners.refused_streams.clear()

    def _forget(self, _: float) -> None:
        self._server.forget_subscriptions()

    def _discharge(self, percent: float) -> None:
        self._first.signals.battery = percent / 100

    def _drift(self, ppm: float) -> None:
        self._first.crystal.set_drift(ppm)

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_lose, _come_back),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.REFUSE: flag("_server.manners.refuses_binding", then=_break_links),
            FaultKind.DENY: lasting(_deny, _give),
            FaultKind.LATE: level("_server.manners.late_s", 0.0, then=_break_links),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.UNREADABLE: flag("_server.delivery.mishaps.foreign"),
            FaultKind.LOW_BATTERY: Effect(_discharge),
            FaultKind.OFF_BODY: flag("_first.signals.is_worn", False),
            FaultKind.DRIFT: Effect(_drift),
            **on_part("_server", {FaultKind.RESTART: lasting(Server.go_down, Server.come_up)}),
            **on_part(
                "_server.listener", {FaultKind.STALL: lasting(Listener.stall, Listener.resume)}
            ),
        }
    )


def _further(first: Specimen, number: int) -> Specimen:
    """Return one that somebody else wears."""
    return Specimen(
        seed=first.seed + number,
        drift_ppm=first.drift_ppm,
        jitter_s=first.jitter_s,
        kept=first.kept,
    )
