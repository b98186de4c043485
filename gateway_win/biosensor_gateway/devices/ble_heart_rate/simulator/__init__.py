"""A virtual heart-rate strap of no particular make."""

from __future__ import annotations

from types import MappingProxyType
from typing import Unpack

from biosensor_gateway.devices.ble_heart_rate.simulator.services import Identity
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import (
    EXPECTED,
    STRAP_EFFECTS,
    Strap,
    StrapDevice,
)
from biosensor_gateway.simulation.faults import FaultKind, flag, lasting, on_part
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.world import World


class SimulatedHeartRateStrap(StrapDevice):
    """Heart Rate, Battery and Device Information services, and nothing else.

    Its measurements contain the skin contact and R-R intervals. Without contact the rate is 0 and
    there are no intervals.

    Parameters
    ----------
    world, radio
        Simulated world and radio.
    address, name
        As advertised.
    rssi_dbm
        Signal strength as received.
    demands_pairing
        Sends its heart rate only to a paired host.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    sensor = "ble_heart_rate"
    each_own = MappingProxyType(
        {"address": "C8:25:00:00:01:{number:02X}", "name": "Heart Strap {next:04}"}
    )
    effects = MappingProxyType(
        on_part(
            "_strap",
            {
                **STRAP_EFFECTS,
                FaultKind.REPEAT: flag("pulse.repeats"),
                FaultKind.DENY: lasting(Strap.deny, Strap.allow),
            },
        )
    )
    expected = EXPECTED
    on_air = True

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "C8:25:00:00:00:01",
        name: str = "Heart Strap 0001",
        rssi_dbm: int = -61,
        demands_pairing: bool = False,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self.device = address
        peripheral = Peripheral(radio, address, name, service_uuids=("180d",), rssi_dbm=rssi_dbm)
        self._strap = Strap(
            peripheral,
            self.truth,
            self.specimen,
            identity=Identity("Virtual Straps", "Heart Strap", "0001", firmware="1.0"),
        )
        if demands_pairing:
            peripheral.demand_pairing = True
            self._strap.heart_rate.demand_pairing()
