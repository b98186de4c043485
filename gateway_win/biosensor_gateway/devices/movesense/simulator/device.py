"""A virtual Movesense sensor on a chest strap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from types import MappingProxyType
from typing import Any, Unpack

from biosensor_gateway.devices.ble_heart_rate.simulator.services import Identity
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import STRAP_EFFECTS, Strap
from biosensor_gateway.devices.ble_heart_rate.simulator.strap_device import StrapDevice
from biosensor_gateway.devices.movesense.simulator.expected import EXPECTED
from biosensor_gateway.devices.movesense.simulator.service import SensorDataService
from biosensor_gateway.devices.movesense.simulator.wire import FULL_MTU
from biosensor_gateway.simulation.effects import Effect, lasting, on_part
from biosensor_gateway.simulation.faults import FaultKind
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.specimen import SpecimenOptions
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World

# The heart rate service, and what the vendor is assigned.
_ADVERTISED = ("180d", "fdf3")
_DENIABLE = ("hr", "temp", "ecg", "movement")
"""What is denied, one at each time."""


@dataclass(frozen=True)
class Firmware:
    """A build of the firmware.

    Attributes
    ----------
    is_old
        Of the first version of the protocol.
    max_mtu
        The largest ATT MTU that it grants.
    demands_pairing
        It takes commands only of a host that has paired.
    """

    is_old: bool = False
    max_mtu: int = FULL_MTU
    demands_pairing: bool = False


class SimulatedMovesense(StrapDevice):
    """A sensor with the services of a strap and the GATT SensorData Protocol.

    Parameters
    ----------
    world, radio
        Where it lives, and the air that it is heard on.
    address
        Bluetooth address.
    serial
        Twelve digits, as engraved.
    firmware
        What it runs; a new one by default.
    deviation
        By which share the movement sensor is faster than it should be.
    rssi_dbm
        How strongly it is heard.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    sensor = "movesense"
    expected = EXPECTED
    on_air = True
    filled = MappingProxyType({"mag": Filled(None, "it is switched off unless the settings ask")})

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "0C:8C:DC:10:F7:D3",
        serial: str = "174630000192",
        firmware: Firmware | None = None,
        deviation: float = 0.02,
        rssi_dbm: int = -60,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self._serial = serial
        self._to_deny = cycle(_DENIABLE)
        firmware = firmware or Firmware()
        peripheral = Peripheral(
            radio,
            address,
            f"Movesense {serial}",
            service_uuids=_ADVERTISED,
            rssi_dbm=rssi_dbm,
            max_mtu=firmware.max_mtu,
        )
        peripheral.demand_pairing = firmware.demands_pairing
        self._strap = Strap(
            peripheral,
            self.truth,
            self.specimen,
            identity=Identity("Movesense", "Movesense HR2", serial, firmware="2.3.1"),
            tells_contact=False,
        )
        self._service = SensorDataService(
            self._strap, serial, is_old=firmware.is_old, deviation=deviation
        )

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Give each an address of its own, too."""
        own = {"address": f"0C:8C:DC:10:F8:{number:02X}", "serial": f"1746300002{number:02d}"}
        return {**super().worn_by(wearer, number), **own}

    @property
    def settings(self) -> Mapping[str, Any]:
        """Fields that lead a driver to it."""
        return {"device": self._serial}

    def _babble(self, packets: float) -> None:
        self._service.babble(packets)

    def _forget(self, _: float) -> None:
        self._service.forget()

    def _refuse(self) -> None:
        self._strap.break_link()
        self._service.refuses = True

    def _comply(self) -> None:
        self._service.refuses = False

    def _deny(self) -> None:
        self._strap.break_link()
        self._service.denied = frozenset({next(self._to_deny)})

    def _allow(self) -> None:
        self._service.denied = frozenset()

    def _answer_late(self, seconds: float) -> None:
        self._strap.break_link()
        self._service.answer_delay_s = seconds

    def _answer_in_time(self) -> None:
        self._service.answer_delay_s = 0.0

    effects = MappingProxyType(
        {
            **on_part("_strap", STRAP_EFFECTS),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: lasting(_refuse, _comply),
            FaultKind.DENY: lasting(_deny, _allow),
            FaultKind.LATE: Effect(_answer_late, _answer_in_time),
        }
    )
