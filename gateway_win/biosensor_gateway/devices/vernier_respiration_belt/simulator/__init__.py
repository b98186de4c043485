"""A virtual respiration belt."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Unpack

import numpy as np
from bumble.att import Attribute
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service
from numpy.typing import NDArray

from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware, Command
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
from biosensor_gateway.simulation.radio_device import RadioDevice
from biosensor_gateway.simulation.truth import (
    NO_INTERVALS,
    TELLS_ITS_RATE,
    Contact,
    Expected,
    LossTolerance,
    Truth,
)
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import Clock

SERVICE_UUID = "D91714EF-28B9-4F91-BA16-F0D9A604F112"
COMMAND_UUID = "F4BF14A6-C7D5-4B6D-8AA8-DF1A7C83ADCB"
RESPONSE_UUID = "B41E6675-A329-40E0-AA01-44D2F444BABE"

PACKET_S = 0.1
"""Duration of the samples in a packet, as with a slow connection interval."""
_ORDER_CODE = "GDX-RB"
_FRAGMENT_BYTES = 20
_GARBAGE_BYTES = 16
_Properties = Characteristic.Properties

EXPECTED = Expected(
    # A belt that is not worn is loose.
    contact=Contact("quality", 1, off=-1.0),
    without_contact=("bpm",),
    by_agent=frozenset({"quality"}),
    # Each connection starts a new series, whose start is only known by its arrival.
    loss_tolerance=LossTolerance(over_break=2, by_arrival=True),
    impossible={
        FaultKind.DENY: "one command starts all of its channels",
        FaultKind.REPEAT: NO_INTERVALS,
        Untidiness.RATE: TELLS_ITS_RATE,
        Untidiness.STRAY: "an answer to no question counts as garbage",
    },
)

RATE_WARM_UP_S = 25.0
"""The belt needs some breaths before it reports a rate."""
RATE_UPDATE_S = 10.0
_SLACK_N = -0.53
_CHANNELS = ((1, "force"), (2, "bpm"))


class _Signals:
    """Force and respiration rate of a belt that may be taken off.

    Parameters
    ----------
    warm_up_s
        Time after every start without a respiration rate.
    """

    def __init__(self, wearer: Wearer, warm_up_s: float, clock: Clock) -> None:
        self._wearer = wearer
        self._warm_up_s = warm_up_s
        self._clock = clock
        self._worn = True
        self.begin()

    def begin(self) -> None:
        """Start the wearer's time now."""
        self._origin_s = self._worn_since_s = self._clock()

    def take_off(self) -> None:
        """Take the belt off, which makes it loose."""
        self._worn = False

    def put_on(self) -> None:
        """Put it on again."""
        self._worn, self._worn_since_s = True, self._clock()

    def rows(self, times: NDArray[np.float64], started_s: float) -> NDArray[np.float32]:
        """Return the measurements at LSL times.

        Parameters
        ----------
        times : ndarray of float64, shape (n,)
        started_s
            LSL time at which the measurement was started.

        Returns
        -------
        ndarray of float32, shape (n, 6)
            Channels 0 to 5: force [N] in 1, rate [1/min] in 2, or NaN if unknown.
        """
        wearer_times = times - self._origin_s
        rows = np.zeros((len(times), 6), np.float32)
        if self._worn:
            rows[:, 1] = self._wearer.chest_force_n(wearer_times)
        else:
            rows[:, 1] = _SLACK_N + self._wearer.noise(wearer_times, 0.003, "slack")
        rows[:, 2] = self._rate(times[-1], started_s)
        return rows

    def _rate(self, time_s: float, started_s: float) -> float:
        known_since_s = max(started_s, self._worn_since_s) + self._warm_up_s
        if not self._worn or time_s < known_since_s:
            return math.nan
        updates = math.floor((time_s - known_since_s) / RATE_UPDATE_S)
        # The belt's own rate has a small, varying error.
        error = 0.3 * math.sin(1.7 * updates)
        return round(self._wearer.respiration_rate_bpm + error, 1)


def _note(
    truth: Truth, times: NDArray[np.float64], rows: NDArray[np.float32], mask: int, *, sent: bool
) -> None:
    """Record samples of the channels in a mask as sent or lost."""
    for channel, data_name in _CHANNELS:
        if not mask & (1 << channel):
            continue
        if sent:
            values = rows[:, channel : channel + 1].astype(np.float64)
            truth.sent(data_name, times.tolist(), values.tolist())
        else:
            truth.unsent(data_name, len(times))


class SimulatedBelt(RadioDevice):
    """A GDX-RB: a sleeping belt whose button has just been pressed.

    Parameters
    ----------
    serial
        Eight characters, part of the advertised name.
    warm_up_s
        Time after every start without a respiration rate.
    rssi_dbm
        Signal strength as received.
    max_mtu
        Largest ATT MTU that it accepts.
    """

    sensor = "vernier_respiration_belt"
    each_own = MappingProxyType(
        {"address": "E0:F5:BD:94:6B:{number:02X}", "serial": "0K21{number:02d}Z5"}
    )
    expected = EXPECTED
    on_air = True
    rates_hz = MappingProxyType({"force": 10.0, "bpm": 10.0})

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "E0:F5:BD:94:6A:1B",
        serial: str = "0K2002Z5",
        warm_up_s: float = RATE_WARM_UP_S,
        rssi_dbm: int = -62,
        max_mtu: int = 158,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        name = f"{_ORDER_CODE} {serial}"
        peripheral = Peripheral(radio, address, name, rssi_dbm=rssi_dbm, max_mtu=max_mtu)
        super().__init__(world, peripheral, **specimen)
        self.device = serial
        self._firmware = BeltFirmware(_ORDER_CODE, serial)
        self._signals = _Signals(self.specimen.wearer, warm_up_s, world.clock)
        self._measuring: asyncio.Task[None] | None = None
        self._sending = asyncio.Lock()
        self._response = Characteristic[bytes](
            RESPONSE_UUID, _Properties.NOTIFY, Attribute.Permissions.READABLE, b""
        )

    async def _start(self) -> None:
        self._signals.begin()
        await super()._start()

    def _services(self) -> Sequence[Service]:
        # Hosts are only identified by writes; the vendor's services are not advertised.
        commands = Characteristic[bytes](
            COMMAND_UUID,
            _Properties.WRITE | _Properties.WRITE_WITHOUT_RESPONSE,
            Attribute.Permissions.WRITEABLE,
            CharacteristicValue(write=self._hear),
        )
        return [Service(SERVICE_UUID, [commands, self._response])]

    def _hear(self, _connection: Connection, fragment: bytes) -> None:
        self._run(self._answer(fragment))

    async def _answer(self, fragment: bytes) -> None:
        starts = self._firmware.starts
        packets = self._firmware.hear(fragment)
        was_asked = [packet[4] for packet in packets]
        if self._answer_delay_s and packets:
            await asyncio.sleep(self._answer_delay_s)
        for packet in packets:
            await self._send(packet)
        if Command.GET_STATUS in was_asked and not self._firmware.refuses:
            self.truth.sent("bat", [self.world.clock()], [(self._firmware.battery_percent,)])
        if self._firmware.starts != starts:
            self._halt()
            self._measuring = self._run(self._measure())
        elif not self._firmware.mask:
            self._halt()

    async def _measure(self) -> None:
        """Send packets of samples; the very first sample is measured at the start."""
        period_s = self._firmware.period_us / 1e6
        count = max(1, round(PACKET_S / period_s))
        begin_s = self._oscillator.now()
        started_s = self.world.clock()
        first = 0
        while True:
            device_times = begin_s + (first + np.arange(count)) * period_s
            await self._oscillator.reach(float(device_times[-1]))
            times = np.array([self._oscillator.true_time(float(time)) for time in device_times])
            if self.specimen.jitter_s:
                await asyncio.sleep(self._rng.uniform(0, self.specimen.jitter_s))
            rows = self._signals.rows(times, started_s)
            mask = self._firmware.mask
            if not mask:
                return
            columns = [channel for channel in range(rows.shape[1]) if mask & (1 << channel)]
            is_readable = self._firmware.knows_type
            sent = await self._send(self._firmware.pack(rows[:, columns]))
            _note(self.truth, times, rows, mask, sent=sent and is_readable)
            first += count

    async def _send(self, packet: bytes) -> bool:
        """Send a packet in as many notifications as needed; return False if one is lost."""
        size = max(_FRAGMENT_BYTES, self._peripheral.host_mtu - 3)
        sent = True
        # Notifications of different packets must not be mixed.
        async with self._sending:
            for begin in range(0, len(packet), size):
                fragment = packet[begin : begin + size]
                sent = await self._peripheral.notify(self._response, fragment) and sent
        return sent

    async def _send_garbage(self, amount: int) -> None:
        for begin in range(0, amount, _GARBAGE_BYTES):
            noise = self._rng.bytes(min(_GARBAGE_BYTES, amount - begin))
            await self._peripheral.notify(self._response, noise)

    def _lose_host(self) -> None:
        super()._lose_host()
        self._firmware.forget()

    def _halt(self) -> None:
        if self._measuring is not None:
            self._measuring.cancel()
            self._measuring = None

    def _forget(self, _: float) -> None:
        self._firmware.mask = 0
        self._halt()

    effects = MappingProxyType(
        {
            **RadioDevice.effects,
            FaultKind.FORGET: Effect(_forget),
            FaultKind.REFUSE: flag("_firmware.refuses", then=RadioDevice.break_link),
            FaultKind.UNREADABLE: flag("_firmware.knows_type", False),
            FaultKind.LOW_BATTERY: level("_firmware.battery_percent", read=round),
            **on_part(
                "_signals", {FaultKind.OFF_BODY: lasting(_Signals.take_off, _Signals.put_on)}
            ),
        }
    )
