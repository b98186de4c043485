"""A virtual Polar H10 or related product."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Unpack

from bumble.att import Attribute
from bumble.core import UUID
from bumble.gatt import Characteristic, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.services import Identity
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import EXPECTED as ANY_STRAP
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import (
    STRAP_EFFECTS,
    Strap,
    StrapDevice,
)
from biosensor_gateway.devices.polar_h10.simulator.pmd_service import PmdService
from biosensor_gateway.devices.polar_h10.simulator.products import (
    H10,
    Firmware,
    Product,
    Quirks,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import TELLS_ITS_RATE, Gap, LossTolerance
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.world import World

EXPECTED = replace(
    ANY_STRAP,
    impossible={
        FaultKind.REPEAT: "its intervals add up to the time that passed",
        Untidiness.RATE: TELLS_ITS_RATE,
        Untidiness.STRAY: "a frame of another measurement counts as garbage",
    },
    bundles_s=8.0,
    # The device is off during the gap.
    gaps={FaultKind.RESTART: Gap.STOPPED},
    # Each connection starts a new series, whose start is only known by time.
    loss_tolerance=LossTolerance(over_break=2),
)

_LOW_BATTERY_PERCENT = 10
# Characteristics of the file transfer service, which existed before PMD.
_FILE_TRANSFER_UUIDS = (
    "FB005C51-02E7-F387-1CAD-8ACD2D8DF0C8",
    "FB005C52-02E7-F387-1CAD-8ACD2D8DF0C8",
)

POLAR_COMPANY_ID = 0x006B
SERVICE_UUIDS = ("180d", "feee")
"""Heart rate, and Polar's file transfer."""
_BROADCAST = 0x20


def manufacturer_data(*, battery_low: bool, contact: bool, counter: int, bpm: int) -> bytes:
    """Return the payload after the company id.

    Parameters
    ----------
    counter
        Counter of payloads, which shows that the sensor is running.
    bpm
        Heart rate, sent as fast and as slow average.
    """
    status = battery_low | contact << 1 | (counter & 7) << 2 | _BROADCAST
    return bytes((status, 0, bpm, bpm))


class Usual(NamedTuple):
    """A product, its Bluetooth address, and the id that is printed on it."""

    product: Product
    address: str
    device_id: str


class SimulatedPolarH10(StrapDevice):
    """A strap with a PMD service, or another product that has one.

    An H10's measurements contain R-R intervals but no skin contact: without contact the rate is 0,
    there are no intervals, and the ECG is noise.

    Parameters
    ----------
    address
        Bluetooth address; like the next two, from `usual` by default.
    device_id
        Eight hexadecimal digits, as printed on the module.
    quirks
        Firmware and circumstances.
    off_body_drop_s
        Time without skin contact after which it switches off, until it is put on again; about 45 s
        for a real one.
    rssi_dbm
        Signal strength as received.
    """

    sensor = "polar_h10"
    each_own = MappingProxyType(
        {"address": "A0:9E:1A:A1:B3:{number:02X}", "device_id": "A1B3{number:04X}"}
    )
    usual: ClassVar[Usual] = Usual(H10, "A0:9E:1A:A1:B2:C3", "A1B2C3D4")
    """The default product."""
    expected = EXPECTED
    on_air = True

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "",
        device_id: str = "",
        product: Product | None = None,
        quirks: Quirks | None = None,
        off_body_drop_s: float = inf,
        rssi_dbm: int = -58,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        quirks = quirks or Quirks()
        product = product or self.usual.product
        device_id = self.device = device_id or self.usual.device_id
        self._payloads = 0
        self._shown_bpm = 0
        name = f"{product.advertised} {device_id}"
        self._strap = Strap(
            _peripheral(radio, address or self.usual.address, name, rssi_dbm, quirks),
            self.truth,
            self.specimen,
            identity=_identity(product, device_id),
            location=product.body_location,
            tells_contact=product.tells_contact,
            sends_rr=product.sends_rr,
            off_body_drop_s=off_body_drop_s,
        )
        self._strap.on_power_on.append(self._advertise)
        self._strap.on_second.append(self._advertise)
        self._pmd: PmdService | None = None
        if quirks.firmware is Firmware.CURRENT:
            self._pmd = PmdService(self._strap, product, quirks)
        elif quirks.firmware is Firmware.OLD:
            self._strap.services.append(_file_transfer_service())

    def _babble(self, packets: float) -> None:
        self._strap.babble(packets)
        if self._pmd is not None:
            self._pmd.babble(packets)

    def _forget(self, _: float) -> None:
        if self._pmd is not None:
            # The heart rate continues.
            self._pmd.forget()
        else:
            self._strap.forget()

    def _break_link(self) -> None:
        self._strap.break_link()

    def _deny(self) -> None:
        self._break_link()
        if self._pmd is not None:
            self._pmd.deny()

    def _give(self) -> None:
        if self._pmd is not None:
            self._pmd.give()

    def _advertise(self) -> None:
        peripheral = self._strap.peripheral
        if peripheral.connected:
            return
        # The last displayed rate is kept when it is taken off.
        self._shown_bpm = self._strap.pulse.bpm or self._shown_bpm
        self._payloads += 1
        payload = manufacturer_data(
            battery_low=self._strap.battery_percent <= _LOW_BATTERY_PERCENT,
            contact=self._strap.worn,
            counter=self._payloads,
            bpm=self._shown_bpm,
        )
        peripheral.set_manufacturer_data({POLAR_COMPANY_ID: payload})

    effects = MappingProxyType(
        {
            **on_part("_strap", STRAP_EFFECTS),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: flag("_pmd.refuses", then=_break_link),
            FaultKind.DENY: lasting(_deny, _give),
            FaultKind.LATE: level("_pmd.answer_delay_s", 0.0, then=_break_link),
        }
    )


def _peripheral(radio: Radio, address: str, name: str, rssi_dbm: int, quirks: Quirks) -> Peripheral:
    peripheral = Peripheral(
        radio,
        address,
        name,
        service_uuids=SERVICE_UUIDS,
        rssi_dbm=rssi_dbm,
        max_mtu=quirks.max_mtu,
    )
    peripheral.demand_pairing = quirks.demands_pairing
    return peripheral


def _identity(product: Product, device_id: str) -> Identity:
    # The texts of a real device end with a NUL.
    return Identity(
        manufacturer="Polar Electro Oy\0",
        model=f"{product.model}\0",
        serial_number=f"{device_id}\0",
        hardware="00760690.03\0",
        firmware=f"{product.firmware}\0",
        software=f"{product.firmware}\0",
    )


def _file_transfer_service() -> Service:
    characteristics = [
        Characteristic[bytes](
            uuid,
            Characteristic.Properties.READ | Characteristic.Properties.NOTIFY,
            Attribute.Permissions.READABLE,
            b"",
        )
        for uuid in _FILE_TRANSFER_UUIDS
    ]
    return Service(UUID.from_16_bits(0xFEEE), characteristics)
