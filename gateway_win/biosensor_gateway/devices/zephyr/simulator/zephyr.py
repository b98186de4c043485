"""The virtual BioHarness 3 on a wearer, with every fault and its truth in declared units."""

from __future__ import annotations

from types import MappingProxyType
from typing import Unpack

from biosensor_gateway.devices.zephyr.simulator.bioharness import BioHarness
from biosensor_gateway.devices.zephyr.simulator.expected import EXPECTED
from biosensor_gateway.devices.zephyr.simulator.notes import Notes
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing
from biosensor_gateway.devices.zephyr.simulator.synthetic import SyntheticSource
from biosensor_gateway.devices.zephyr.simulator.wire import REQUESTS
from biosensor_gateway.simulation.effects import Effect, lasting
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.specimen import SpecimenOptions
from biosensor_gateway.simulation.world import World


class SimulatedZephyr(BioHarness):
    """A BioHarness 3 that somebody wears.

    Its `truth` holds the streams of the packets that the host switched on.

    Parameters
    ----------
    world
        Where it lives.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    expected = EXPECTED

    def __init__(self, world: World, **specimen: Unpack[SpecimenOptions]) -> None:
        self._body = SyntheticSource(**specimen)
        super().__init__(world, self._body, **specimen)
        self._notes = Notes(self.truth)

    def _note(self, frame: Outgoing, *, sent: bool) -> None:
        self._notes.note(frame, sent=sent)

    def _go_down(self) -> None:
        self._hang_up()

    def _come_up(self) -> None:
        self._body.power_cycle()
        self._reopen()

    def _break_link(self) -> None:
        self._hang_up()
        self._reopen()

    def _forget(self, _: float) -> None:
        self.session.forget_enables()

    def _refuse(self) -> None:
        self.session.refused.update(REQUESTS)
        self._break_link()

    def _allow(self) -> None:
        self.session.refused.difference_update(REQUESTS)

    def _answer_late(self, seconds: float) -> None:
        self.session.answer_delay_s = seconds
        self._break_link()

    def _answer_in_time(self) -> None:
        self.session.answer_delay_s = 0.0

    def _take_off(self) -> None:
        self._body.set_worn(worn=False)

    def _put_on(self) -> None:
        self._body.set_worn(worn=True)

    def _discharge(self, percent: float) -> None:
        self._body.battery_percent = round(percent)

    def _drift(self, ppm: float) -> None:
        self._body.set_drift(ppm)

    effects = MappingProxyType(
        {
            **BioHarness.effects,
            FaultKind.RESTART: lasting(_go_down, _come_up),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: lasting(_refuse, _allow),
            FaultKind.LATE: Effect(_answer_late, _answer_in_time),
            FaultKind.OFF_BODY: lasting(_take_off, _put_on),
            FaultKind.LOW_BATTERY: Effect(_discharge),
            FaultKind.DRIFT: Effect(_drift),
        }
    )
