"""The parts common to virtual heart-rate straps: power, skin contact, battery, heart rate.

A virtual device contains a `Strap` and adds its own features.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from itertools import count, cycle
from math import inf, isfinite
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
from bumble.gatt import Characteristic, Service

from biosensor_gateway.devices.ble_heart_rate.simulator.services import (
    CHEST,
    RR_TICKS_PER_S,
    BatteryService,
    HeartRateMeasurement,
    HeartRateService,
    Identity,
    damaged,
    encode,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    Effects,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    on_part,
    restart,
)
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio_device import RADIO_EFFECTS, PowerSwitch
from biosensor_gateway.simulation.truth import NO_RATE, SAYS_WHAT_IT_IS, Expected, Truth
from biosensor_gateway.simulation.virtual_device import Specimen, VirtualDevice
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import Oscillator

_NO_COMMANDS = "without a control point there is no command to refuse or to answer late"

EXPECTED = Expected(
    without_contact=("hr", "ibi"),
    by_agent=frozenset({"quality"}),
    # The timing of a beat is only known to be in the second before its packet.
    unstamped_s={"hr": 0.0, "ibi": 0.1},
    impossible={
        FaultKind.REFUSE: _NO_COMMANDS,
        FaultKind.LATE: _NO_COMMANDS,
        Untidiness.RATE: NO_RATE,
        Untidiness.STRAY: SAYS_WHAT_IT_IS,
    },
)


_AVERAGED_INTERVALS = 4


class Interval(NamedTuple):
    """The time between two R peaks."""

    time: float  # LSL time of the second peak.
    rr: int  # Length [1/1024 s by the device's oscillator].


class MeasurementStream(Protocol):
    """A running measurement."""

    async def run(self) -> None:
        """Measure and send until cancelled."""
        ...

    def end(self) -> None:
        """Record what was measured but not sent, after `run` was cancelled."""
        ...


class BeatDetector:
    """Finds R peaks and measures the intervals between them.

    The ends of intervals are rounded instead of their lengths, so that sums over many beats stay
    exact.

    Parameters
    ----------
    oscillator
        Oscillator of the device since power-on.
    origin_s
        LSL time at which the wearer's time is 0.
    begin_s
        LSL time of the start of the search.
    """

    def __init__(
        self, wearer: Wearer, oscillator: Oscillator, origin_s: float, begin_s: float
    ) -> None:
        self._wearer = wearer
        self._oscillator = oscillator
        self._origin_s = origin_s
        self._searched_s = begin_s
        self._last_tick: int | None = None
        self._recent: deque[int] = deque(maxlen=_AVERAGED_INTERVALS)

    @property
    def bpm(self) -> int:
        """Rate over the last four intervals [1/min]; 0 before the first one."""
        if not self._recent:
            return 0
        return round(60 * RR_TICKS_PER_S * len(self._recent) / sum(self._recent))

    def search(self, until_s: float) -> list[Interval]:
        """Return the intervals that ended since the last search, oldest first."""
        begin, end = self._searched_s - self._origin_s, until_s - self._origin_s
        self._searched_s = until_s
        intervals: list[Interval] = []
        for beat_s in self._wearer.beats_between(begin, end) + self._origin_s:
            time = float(beat_s)
            tick = int(np.rint(self._oscillator.at(time) * RR_TICKS_PER_S))
            if self._last_tick is not None:
                intervals.append(Interval(time, tick - self._last_tick))
            self._last_tick = tick
        self._recent.extend(interval.rr for interval in intervals)
        return intervals

    def begin_at(self, time_s: float) -> None:
        """Ignore beats before an LSL time, for example when the device was put on."""
        if time_s > self._searched_s:
            self.lose(time_s)

    def lose(self, until_s: float) -> None:
        """Skip to ``until_s`` without skin contact; the next interval needs two new beats."""
        self._searched_s = until_s
        self._last_tick = None
        self._recent.clear()


_BATTERY_PERCENT = 87


class Pulse:
    """Heart rate and intervals, from detector to truth.

    Parameters
    ----------
    tells_contact
        Measurements say whether the strap touches the skin.
    sends_rr
        Measurements carry R-R intervals.
    """

    def __init__(self, detector: BeatDetector, *, tells_contact: bool, sends_rr: bool) -> None:
        self._detector = detector
        self._tells_contact = tells_contact
        self._sends_rr = sends_rr
        self._intervals: Sequence[Interval] = ()
        self._worn = True
        self._last: tuple[int, ...] = ()
        self.repeats = False  # The last interval of each measurement is repeated in the next one.

    @property
    def bpm(self) -> int:
        """The displayed rate [1/min]; 0 = none."""
        return self._detector.bpm

    def measure(self, until_s: float, *, worn: bool) -> HeartRateMeasurement:
        """Return the measurement to send at an LSL time."""
        self._worn = worn
        if worn:
            self._intervals = self._detector.search(until_s)
        else:
            self._intervals = ()
            self._detector.lose(until_s)
        told = tuple(interval.rr for interval in self._intervals)
        again, self._last = self._last if self.repeats else (), told[-1:] or self._last
        return HeartRateMeasurement(
            self.bpm,
            again + told if self._sends_rr else None,
            worn if self._tells_contact else None,
        )

    def note(self, truth: Truth, measured_s: float, *, sent: bool) -> None:
        """Record the last measurement in the truth as sent or lost."""
        rows: dict[str, tuple[list[float], list[tuple[float]]]] = {
            "quality": ([measured_s], [(float(self._worn),)])
        }
        if self.bpm:
            rows["hr"] = ([measured_s], [(float(self.bpm),)])
        if self._sends_rr and self._intervals:
            times = [interval.time for interval in self._intervals]
            rows["ibi"] = (times, [(one.rr / RR_TICKS_PER_S,) for one in self._intervals])
        for data_name, (times, values) in rows.items():
            if sent:
                truth.sent(data_name, times, values)
            else:
                truth.unsent(data_name, len(times))


class Strap:
    """A strap with its radio; everything except the constructor runs in the world's event loop.

    Parameters
    ----------
    specimen
        Its wearer, and the properties of its oscillator and radio.
    identity, location
        Contents of its services.
    tells_contact, sends_rr
        Contents of its heart rate measurements.
    off_body_drop_s
        Time without skin contact after which it switches off, until it is put on again.

    Attributes
    ----------
    services
        Its GATT services; may be extended until it is switched on.
    oscillator
        Device clock since power-on.
    origin_s
        LSL time at which the wearer's time is 0, which is the first power-on.
    worn, battery_percent
        Current state.
    put_on_s
        LSL time at which it was last put on; -inf if it was never taken off.
    pulse
        Its heart rate measurement.
    is_unreadable
        Whether it sends measurements in an unknown format.
    pulse_every_s
        Interval between heart rate measurements; 0 = none.
    on_power_on, on_power_off, on_second
        Called after power-on, before power-off, and after every measurement.
    """

    def __init__(
        self,
        peripheral: Peripheral,
        truth: Truth,
        specimen: Specimen,
        *,
        identity: Identity,
        location: int = CHEST,
        tells_contact: bool = True,
        sends_rr: bool = True,
        off_body_drop_s: float = inf,
    ) -> None:
        self.peripheral = peripheral
        self.truth = truth
        self.wearer = specimen.wearer
        self.rng = np.random.default_rng(specimen.seed)
        self.worn = True
        self.put_on_s = -inf
        self.is_unreadable = False
        self.pulse_every_s = 1
        self.battery_percent = _BATTERY_PERCENT
        self.on_power_on: list[Callable[[], None]] = []
        self.on_power_off: list[Callable[[], None]] = []
        self.on_second: list[Callable[[], None]] = []
        self.heart_rate = HeartRateService(location)
        self._battery = BatteryService(self._read_battery)
        self._to_deny = cycle((self._battery.level.uuid, self.heart_rate.measurement.uuid))
        services = (self.heart_rate.service, self._battery.service, identity.service())
        self.services: list[Service] = list(services)
        self._drift_ppm = specimen.drift_ppm
        self._jitter_s = specimen.jitter_s
        self._tells_contact = tells_contact
        self._sends_rr = sends_rr
        self._off_body_drop_s = off_body_drop_s
        self.power = PowerSwitch(self._power_on, self._power_off)
        self._tasks: set[asyncio.Task[None]] = set()
        self._leaving: asyncio.TimerHandle | None = None
        self.origin_s = self.peripheral.clock()
        self._reset()
        peripheral.on_connected.append(self._note_signal)

    async def start(self) -> None:
        """Switch it on for the first time."""
        self.origin_s = self.peripheral.clock()
        await self.power.want(True)

    async def stop(self) -> None:
        """Switch it off for good."""
        await self.power.want(False)

    def drop(self) -> None:
        """Move it out of range."""
        self.peripheral.drop()

    def restore(self) -> None:
        """Move it back into range."""
        self.peripheral.restore()

    def babble(self, packets: float) -> None:
        """Send damaged heart rate measurements."""
        self.run(self._send_garbage(round(packets)))

    def forget(self, _: float = 0.0) -> None:
        """Forget the subscription to the heart rate."""
        self.peripheral.forget_subscription(self.heart_rate.measurement)

    def deny_by_turns(self, characteristics: Sequence[Characteristic[bytes]]) -> None:
        """Let successive calls of `deny` deny the battery or these in turn, not the heart rate."""
        self._to_deny = cycle((self._battery.level.uuid, *(each.uuid for each in characteristics)))

    def deny(self) -> None:
        """Break the link, and refuse one signal from now on, a different one each time."""
        self.peripheral.deny((next(self._to_deny),))
        self.break_link()

    def allow(self) -> None:
        """Stop refusing signals."""
        self.peripheral.deny(())

    def discharge(self, percent: float) -> None:
        """Set the battery level and notify it."""
        self.run(self._set_battery(round(percent)))

    def take_off(self) -> None:
        """Take it off the skin."""
        self.worn = False
        if isfinite(self._off_body_drop_s):
            self._leaving = asyncio.get_running_loop().call_later(
                self._off_body_drop_s, self.power.hold_off, FaultKind.OFF_BODY
            )

    def put_on(self) -> None:
        """Put it on again, which switches it on."""
        self.worn, self.put_on_s = True, self.oscillator.clock()
        if self._leaving is not None:
            self._leaving.cancel()
        self.power.release(FaultKind.OFF_BODY)

    def drift(self, ppm: float) -> None:
        """Let the oscillator run too fast."""
        self._drift_ppm = ppm
        self.oscillator.set_drift(ppm)

    def break_link(self) -> None:
        """Break the link; it is connectable again at once."""
        self.drop()
        self.restore()

    def run(self, coroutine: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine in the background, until power-off at most."""
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
        # Packets being sent still arrive, and their senders record them as sent.
        await self.peripheral.power_off()
        for task in self._tasks:
            task.cancel()

    def _reset(self) -> None:
        self.oscillator = Oscillator(self.peripheral.clock, self._drift_ppm)
        detector = BeatDetector(
            self.wearer, self.oscillator, self.origin_s, self.peripheral.clock()
        )
        self.pulse = Pulse(detector, tells_contact=self._tells_contact, sends_rr=self._sends_rr)

    async def _measure(self) -> None:
        for second in count(1):
            measured_s = await self.oscillator.reach(second)
            if self.pulse_every_s and second % self.pulse_every_s == 0:
                await self._send_pulse(measured_s)
            _call(self.on_second)

    async def _send_pulse(self, measured_s: float) -> None:
        value = encode(self.pulse.measure(measured_s, worn=self.worn))
        is_readable = not self.is_unreadable
        characteristic = self.heart_rate.measurement
        expected = self.peripheral.subscribed(characteristic)
        sent = await self.send(characteristic, value if is_readable else value[:1])
        sent = sent and is_readable
        if sent or expected:
            self.pulse.note(self.truth, measured_s, sent=sent)

    async def _send_garbage(self, packets: int) -> None:
        for value in damaged(packets):
            await self.peripheral.notify(self.heart_rate.measurement, value)

    def _read_battery(self) -> int:
        self._note("bat", self.battery_percent)
        return self.battery_percent

    async def _set_battery(self, percent: int) -> None:
        self.battery_percent = percent
        if await self.peripheral.notify(self._battery.level, bytes((percent,))):
            self._note("bat", percent)

    def _note_signal(self) -> None:
        self._note("rssi", self.peripheral.rssi_dbm)

    def _note(self, data_name: str, value: float) -> None:
        self.truth.sent(data_name, [self.peripheral.clock()], [(value,)])


STRAP_EFFECTS: Effects[Strap] = MappingProxyType(
    {
        **on_part("peripheral", RADIO_EFFECTS),
        FaultKind.GARBAGE: Effect(Strap.babble),
        FaultKind.FORGET: Effect(Strap.forget),
        FaultKind.UNREADABLE: flag("is_unreadable"),
        FaultKind.RESTART: restart("power"),
        FaultKind.LOW_BATTERY: Effect(Strap.discharge),
        FaultKind.OFF_BODY: lasting(Strap.take_off, Strap.put_on),
        FaultKind.DRIFT: Effect(Strap.drift),
    }
)
"""Faults and effects common to all straps."""


def _call(functions: Sequence[Callable[[], None]]) -> None:
    for function in functions:
        function()


class StrapDevice(VirtualDevice):
    """A virtual device around a strap, which subclasses create."""

    _strap: Strap

    async def _start(self) -> None:
        await self._strap.start()

    async def _stop(self) -> None:
        await self._strap.stop()
