"""A virtual Cortex service with a headset.

::

    with World() as world, SimulatedCortex(world, seed=1) as cortex:
        cortex.settings  # url, ca_file, headset
        cortex.client_id, cortex.client_secret
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Unpack

from biosensor_gateway.devices.emotiv_insight.simulator.circumstances import APP, Circumstances
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Timing
from biosensor_gateway.devices.emotiv_insight.simulator.models import INSIGHT_1, Model
from biosensor_gateway.devices.emotiv_insight.simulator.service import Service, Setup
from biosensor_gateway.simulation.effects import Effect, Effects, lasting, on_part
from biosensor_gateway.simulation.expected import Contact, Expected, Gap
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.specimen import SpecimenOptions
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.simulation.world import World

EXPECTED = Expected(
    # The contact of all electrodes together, in percent.
    contact=Contact("dev", 7),
    without_contact=("met",),
    # Cortex lets go of the headset, which then measures nothing. Its numbers and times tell
    # exactly what is lost.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)


def _stall(service: Service) -> None:
    service.listener.stall()


def _resume(service: Service) -> None:
    service.listener.resume()


def _babble(service: Service, messages: float) -> None:
    service.send_garbage(round(messages))


def _send_unannounced(service: Service) -> None:
    service.mishaps.unannounced = True


def _send_announced(service: Service) -> None:
    service.mishaps.unannounced = False


def _comply(service: Service) -> None:
    service.manners.refusal = None


def _answer_in_time(service: Service) -> None:
    service.manners.late_s = 0.0


def _forget(service: Service, _: float) -> None:
    service.sessions.forget_subscriptions()


def _discharge(service: Service, percent: float) -> None:
    service.set_battery(round(percent))


def _take_off(service: Service) -> None:
    service.set_worn(is_worn=False)


def _put_on(service: Service) -> None:
    service.set_worn(is_worn=True)


EFFECTS: Effects[Service] = MappingProxyType(
    {
        FaultKind.DROP: lasting(Service.drop, Service.restore),
        FaultKind.STALL: lasting(_stall, _resume),
        FaultKind.GARBAGE: Effect(_babble),
        FaultKind.REFUSE: lasting(Service.refuse, _comply),
        FaultKind.LATE: Effect(Service.delay, _answer_in_time),
        FaultKind.FORGET: Effect(_forget),
        FaultKind.UNREADABLE: lasting(_send_unannounced, _send_announced),
        FaultKind.RESTART: lasting(Service.go_down, Service.come_up),
        FaultKind.LOW_BATTERY: Effect(_discharge),
        FaultKind.OFF_BODY: lasting(_take_off, _put_on),
        FaultKind.DRIFT: Effect(Service.set_drift),
    }
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
    effects = MappingProxyType(on_part("_service", EFFECTS))
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
