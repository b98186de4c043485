"""The parts of every heart-rate strap: power, skin contact, a battery, a pulse once a second.

A virtual device is built around a `Strap` and adds what it can do besides.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from itertools import count
from math import inf, isfinite

import numpy as np
from bumble.gatt import Characteristic, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.heart import BeatDetector
from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import damaged, encode
from biosensor_gateway.devices.ble_heart_rate.simulator.pulse import Pulse
from biosensor_gateway.devices.ble_heart_rate.simulator.services import (
    CHEST,
    BatteryService,
    HeartRateService,
    Identity,
)
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.power import PowerSwitch
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.wearer import Wearer

STRAP_FAULTS = frozenset(
    {
        FaultKind.DROP,
        FaultKind.STALL,
        FaultKind.GARBAGE,
        FaultKind.FORGET,
        FaultKind.RESTART,
        FaultKind.LOW_BATTERY,
        FaultKind.OFF_BODY,
        FaultKind.DRIFT,
    }
)
"""What can happen to a `Strap`."""
_BATTERY_PERCENT = 87


class Strap:
    """A strap on the air; everything but the constructor is for the world's loop.

    Parameters
    ----------
    peripheral
        Its radio.
    truth
        Takes what it measured.
    identity, location
        What its services say about it.
    rssi_dbm
        How strongly the radio is heard.
    wearer
        Who wears it.
    seed
        Of radio delays and garbage.
    drift_ppm
        Of the crystal.
    jitter_s
        Packets leave up to so much late.
    tells_contact, sends_rr
        What its heart rate measurements carry.
    off_body_drop_s
        So long after it left the skin it switches itself off, until it is put on again.

    Attributes
    ----------
    services
        Its GATT table; may be extended until it is switched on.
    crystal
        Device time since power-on.
    origin_s
        LSL time at which the wearer's time is 0: when it was first switched on.
    worn, battery_percent
        As they are now.
    pulse
        Its heart rate measurement.
    on_power_on, on_power_off, on_second
        Called when it has been switched on, before it is switched off, and after
        every measurement.
    """

    def __init__(
        self,
        peripheral: Peripheral,
        truth: Truth,
        *,
        identity: Identity,
        rssi_dbm: int,
        location: int = CHEST,
        wearer: Wearer | None = None,
        seed: int = 0,
        drift_ppm: float = 0.0,
        jitter_s: float = 0.0,
        tells_contact: bool = True,
        sends_rr: bool = True,
        off_body_drop_s: float = inf,
    ) -> None:
        self.peripheral = peripheral
        self.truth = truth
        self.wearer = wearer or Wearer(seed)
        self.rng = np.random.default_rng(seed)
        self.worn = True
        self.battery_percent = _BATTERY_PERCENT
        self.on_power_on: list[Callable[[], None]] = []
        self.on_power_off: list[Callable[[], None]] = []
        self.on_second: list[Callable[[], None]] = []
        self._heart_rate = HeartRateService(location)
        self._battery = BatteryService(self._read_battery)
        services = (self._heart_rate.service, self._battery.service, identity.service())
        self.services: list[Service] = list(services)
        self._rssi_dbm = rssi_dbm
        self._drift_ppm = drift_ppm
        self._jitter_s = jitter_s
        self._tells_contact = tells_contact
        self._sends_rr = sends_rr
        self._off_body_drop_s = off_body_drop_s
        self._power = PowerSwitch(self._power_on, self._power_off)
        self._tasks: set[asyncio.Task[None]] = set()
        self._leaving: asyncio.TimerHandle | None = None
        self.origin_s = self.peripheral.clock()
        self._reset()
        peripheral.on_connected.append(self._note_signal)

    async def start(self) -> None:
        """Switch it on for the first time."""
        self.origin_s = self.peripheral.clock()
        await self._power.want(True)

    async def stop(self) -> None:
        """Switch it off for good."""
        await self._power.want(False)

    def begin(self, fault: Fault) -> None:
        """Begin one of `STRAP_FAULTS`."""
        match fault.kind:
            case FaultKind.DROP:
                self.peripheral.drop()
            case FaultKind.STALL:
                self.peripheral.stalled = True
            case FaultKind.GARBAGE:
                self.run(self._send_garbage(round(fault.value)))
            case FaultKind.FORGET:
                self.peripheral.forget_subscription(self._heart_rate.measurement)
            case FaultKind.LOW_BATTERY:
                self.run(self._set_battery(round(fault.value)))
            case FaultKind.OFF_BODY:
                self._take_off()
            case FaultKind.DRIFT:
                self._drift_ppm = fault.value
                self.crystal.set_drift(fault.value)
            case _:
                self._power.hold_off(fault.kind)

    def end(self, kind: FaultKind) -> None:
        """End one that lasts."""
        match kind:
            case FaultKind.DROP:
                self.peripheral.restore()
            case FaultKind.STALL:
                self.peripheral.stalled = False
            case FaultKind.OFF_BODY:
                self._put_on()
            case _:
                self._power.release(kind)

    def break_link(self) -> None:
        """Lose the host, and be there again at once."""
        self.peripheral.drop()
        self.peripheral.restore()

    def run(self, coroutine: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine beside everything else, until power-off at the longest."""
        task = asyncio.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def send(self, characteristic: Characteristic[bytes], value: bytes) -> bool:
        """Notify a value after the radio's delay; False if it was not sent."""
        if self._jitter_s:
            await asyncio.sleep(self.rng.uniform(0, self._jitter_s))
        return await self.peripheral.notify(characteristic, value)

    async def _power_on(self) -> None:
        self._reset()
        await self.peripheral.power_on(self.services)
        self.run(self._measure())
        _call(self.on_power_on)

    async def _power_off(self) -> None:
        _call(self.on_power_off)
        for task in self._tasks:
            task.cancel()
        await self.peripheral.power_off()

    def _reset(self) -> None:
        self.crystal = Crystal(self.peripheral.clock, self._drift_ppm)
        detector = BeatDetector(self.wearer, self.crystal, self.origin_s, self.peripheral.clock())
        self.pulse = Pulse(detector, tells_contact=self._tells_contact, sends_rr=self._sends_rr)

    async def _measure(self) -> None:
        for second in count(1):
            measured_s = await self.crystal.reach(second)
            value = encode(self.pulse.measure(measured_s, worn=self.worn))
            characteristic = self._heart_rate.measurement
            expected = self.peripheral.subscribed(characteristic)
            sent = await self.send(characteristic, value)
            if sent or expected:
                self.pulse.note(self.truth, measured_s, sent=sent)
            _call(self.on_second)

    async def _send_garbage(self, packets: int) -> None:
        for value in damaged(packets):
            await self.peripheral.notify(self._heart_rate.measurement, value)

    def _read_battery(self) -> int:
        self._note("bat", self.battery_percent)
        return self.battery_percent

    async def _set_battery(self, percent: int) -> None:
        self.battery_percent = percent
        if await self.peripheral.notify(self._battery.level, bytes((percent,))):
            self._note("bat", percent)

    def _note_signal(self) -> None:
        self._note("rssi", self._rssi_dbm)

    def _note(self, data_name: str, value: float) -> None:
        self.truth.sent(data_name, [self.peripheral.clock()], [(value,)])

    def _take_off(self) -> None:
        self.worn = False
        if isfinite(self._off_body_drop_s):
            self._leaving = asyncio.get_running_loop().call_later(
                self._off_body_drop_s, self._power.hold_off, FaultKind.OFF_BODY
            )

    def _put_on(self) -> None:
        self.worn = True
        if self._leaving is not None:
            self._leaving.cancel()
        self._power.release(FaultKind.OFF_BODY)


def _call(functions: Sequence[Callable[[], None]]) -> None:
    for function in functions:
        function()
