"""A virtual Polar strap that advertises its heart rate."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import replace
from types import MappingProxyType
from typing import Unpack

from biosensor_gateway.devices.ble_heart_rate.simulator.services import Identity
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import EXPECTED as ANY_STRAP
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import (
    STRAP_EFFECTS,
    Strap,
    StrapDevice,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    on_part,
)
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import NO_INTERVALS, NO_RATE, LossTolerance
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.world import World

# Layout: polar-ble-sdk, class BlePolarHrAdvertisement.
_POLAR = 0x006B
_BATTERY, _SKIN, _ON_AIR = 0x01, 0x02, 0x20
_SLOW_SECONDS = 8
# Both are longer than the time until new data are advertised.
_GARBAGE_S, _BETWEEN_S = 0.1, 0.15
_NO_LINK = "nothing connects to it, so it has nothing to answer, refuse or forget"

EXPECTED = replace(
    ANY_STRAP,
    without_contact=("hr", "hr_fast"),
    by_agent=frozenset({"quality", "rssi"}),
    # A measurement is received with the next advertisement.
    unstamped_s={"hr": 0.1, "hr_fast": 0.1},
    loss_tolerance=LossTolerance(over_break=1, over_restart={"hr": 9, "hr_fast": 9}),
    impossible={
        **dict.fromkeys(
            (FaultKind.REFUSE, FaultKind.LATE, FaultKind.FORGET, FaultKind.DENY), _NO_LINK
        ),
        FaultKind.REPEAT: NO_INTERVALS,
        Untidiness.RATE: NO_RATE,
        Untidiness.STRAY: "other devices advertise with their own address",
        FaultKind.LOW_BATTERY: "it reports no charge, only whether the battery is sufficient",
    },
    is_linked=False,
)


class SimulatedPolarBroadcast(StrapDevice):
    """A Polar H9 connected to another host: it advertises its heart rate but no services.

    Parameters
    ----------
    address, device_id
        Address, and the id printed on it, which is part of its name.
    rssi_dbm
        Signal strength as received.
    interval_ms
        Interval between advertisements.
    """

    sensor = "polar_broadcast"
    each_own = MappingProxyType(
        {"address": "A0:9E:1A:00:01:{number:02X}", "device_id": "B00001{number:02X}"}
    )
    expected = EXPECTED
    on_air = only_advertises = True

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "A0:9E:1A:00:00:01",
        device_id: str = "B0000001",
        rssi_dbm: int = -66,
        interval_ms: float = 50.0,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self.device = device_id
        self._strap = Strap(
            Peripheral(
                radio, address, f"Polar H9 {device_id}", rssi_dbm=rssi_dbm, interval_ms=interval_ms
            ),
            self.truth,
            self.specimen,
            identity=Identity("Polar Electro Oy", "H9", device_id),
        )
        # Only the connected host receives heart rate notifications.
        self._strap.pulse_every_s = 0
        self._strap.on_power_on.append(self._begin)
        self._strap.on_second.append(self._measure)
        self._battery_ok = True
        self._stands_still = False
        self._begin()

    def _begin(self) -> None:
        self._counter = 0
        self._rates = deque[int](maxlen=_SLOW_SECONDS)
        self._shown = (0, 0)
        self._unheard: dict[str, tuple[float, float]] = {}
        self._advertise()

    def _measure(self) -> None:
        """Measure once a second; off the body, the last rate is kept."""
        if self._stands_still:
            return
        strap, now_s = self._strap, self._strap.peripheral.clock()
        self._counter = (self._counter + 1) % 8
        bpm = strap.pulse.measure(now_s, worn=strap.worn).bpm
        if bpm:
            self._rates.append(bpm)
            self._shown = (bpm, round(sum(self._rates) / len(self._rates)))
        elif strap.worn:
            self._rates.clear()
            self._shown = (0, 0)
        self._advertise()
        for name in self._unheard:
            self.truth.unsent(name, 1)
        rates = zip(("hr_fast", "hr"), self._shown, strict=True) if bpm else ()
        self._unheard = {name: (now_s, float(rate)) for name, rate in rates}
        self._note_heard()

    def _note_heard(self) -> None:
        """Record the newest measurement as sent, if it can be received now."""
        if self._strap.peripheral.is_heard and not self._strap.is_unreadable:
            for name, (measured_s, rate) in self._unheard.items():
                self.truth.sent(name, [measured_s], [(rate,)])
            self._unheard = {}

    def _come_back(self) -> None:
        self._strap.restore()
        self._note_heard()

    def _go_away(self) -> None:
        self._strap.drop()

    def _advertise(self, data: bytes | None = None) -> None:
        flags = _ON_AIR | self._counter << 2
        flags |= _BATTERY * self._battery_ok | _SKIN * self._strap.worn
        block = bytes((flags, 0, *self._shown))
        if data is None:
            data = block[:2] if self._strap.is_unreadable else block
        self._strap.peripheral.set_manufacturer_data({_POLAR: data})

    def _babble(self, times: float) -> None:
        self._strap.run(self._send_garbage(round(times)))

    async def _send_garbage(self, times: int) -> None:
        for number in range(times):
            self._advertise(bytes((number & 0xBF,)))
            await asyncio.sleep(_GARBAGE_S)
            self._advertise()
            await asyncio.sleep(_BETWEEN_S)

    effects = MappingProxyType(
        {
            **{
                kind: effect
                for kind, effect in on_part("_strap", STRAP_EFFECTS).items()
                if kind not in EXPECTED.impossible
            },
            FaultKind.DROP: lasting(_go_away, _come_back),
            FaultKind.STALL: flag("_stands_still"),
            FaultKind.GARBAGE: Effect(_babble),
        }
    )
