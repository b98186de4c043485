"""A virtual respiration belt on the air."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Coroutine, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from bumble.att import Attribute
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service
from numpy.typing import NDArray

from biosensor_gateway.devices.vernier_respiration_belt.simulator.expected import EXPECTED
from biosensor_gateway.devices.vernier_respiration_belt.simulator.firmware import BeltFirmware
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import Command
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.power import PowerSwitch
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World

SERVICE_UUID = "D91714EF-28B9-4F91-BA16-F0D9A604F112"
COMMAND_UUID = "F4BF14A6-C7D5-4B6D-8AA8-DF1A7C83ADCB"
RESPONSE_UUID = "B41E6675-A329-40E0-AA01-44D2F444BABE"

RATE_WARM_UP_S = 25.0
"""The belt needs some breaths before it knows a rate."""
RATE_UPDATE_S = 10.0
PACKET_S = 0.1
"""Samples wait for each other about so long, as with a slow connection interval."""
_SLACK_N = -0.53
_ORDER_CODE = "GDX-RB"
_FRAGMENT_BYTES = 20
_GARBAGE_BYTES = 16
_Properties = Characteristic.Properties


class SimulatedBelt(VirtualDevice):
    """A GDX-RB: a sleeping belt whose button has just been pressed.

    Parameters
    ----------
    world, radio
        Where it lives, and the air that it is heard on.
    address
        Bluetooth address.
    serial
        Eight characters, part of the advertised name.
    wearer
        Who wears it; somebody made from ``seed`` by default.
    seed
        Of radio delays and garbage.
    drift_ppm
        Of its crystal.
    jitter_s
        Packets leave up to so much late.
    warm_up_s
        The belt knows no respiration rate for so long after every start.
    rssi_dbm
        How strongly it is heard.
    max_mtu
        The largest ATT MTU that it grants.
    kept
        Limit of the truth; None = all.
    """

    sensor = "vernier_respiration_belt"
    faults = frozenset(FaultKind)
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
        wearer: Wearer | None = None,
        seed: int = 0,
        drift_ppm: float = 0.0,
        jitter_s: float = 0.0,
        warm_up_s: float = RATE_WARM_UP_S,
        rssi_dbm: int = -62,
        max_mtu: int = 158,
        kept: int | None = None,
    ) -> None:
        super().__init__(world, kept)
        self._serial = serial
        self._firmware = BeltFirmware(_ORDER_CODE, serial)
        self._wearer = wearer or Wearer(seed)
        self._rng = np.random.default_rng(seed)
        self._drift_ppm = drift_ppm
        self._jitter_s = jitter_s
        self._warm_up_s = warm_up_s
        self._rssi_dbm = rssi_dbm
        self._answer_delay_s = 0.0
        self._worn_since_s = 0.0
        self._worn = True
        self._origin_s = self.world.clock()
        self._crystal = Crystal(world.clock, drift_ppm)
        self._power = PowerSwitch(self._power_on, self._power_off)
        self._tasks: set[asyncio.Task[None]] = set()
        self._measuring: asyncio.Task[None] | None = None
        self._sending = asyncio.Lock()
        self._response = Characteristic[bytes](
            RESPONSE_UUID, _Properties.NOTIFY, Attribute.Permissions.READABLE, b""
        )
        self._peripheral = Peripheral(
            radio, address, f"{_ORDER_CODE} {serial}", rssi_dbm=rssi_dbm, max_mtu=max_mtu
        )
        self._peripheral.on_connected.append(self._note_signal)
        self._peripheral.on_disconnected.append(self._lose_host)

    @property
    def settings(self) -> Mapping[str, Any]:
        """Fields that lead a driver to it."""
        return {"device": self._serial}

    async def _start(self) -> None:
        self._origin_s = self._worn_since_s = self.world.clock()
        await self._power.want(True)

    async def _stop(self) -> None:
        await self._power.want(False)

    def _begin(self, fault: Fault) -> None:
        match fault.kind:
            case FaultKind.DROP:
                self._peripheral.drop()
            case FaultKind.STALL:
                self._peripheral.stalled = True
            case FaultKind.GARBAGE:
                self._run(self._send_garbage(round(fault.value)))
            case FaultKind.REFUSE:
                self._firmware.refuses = True
                self._break_link()
            case FaultKind.LATE:
                self._answer_delay_s = fault.value
                self._break_link()
            case FaultKind.FORGET:
                self._firmware.mask = 0
                self._stop_measuring()
            case FaultKind.RESTART:
                self._power.hold_off(fault.kind)
            case FaultKind.LOW_BATTERY:
                self._firmware.battery_percent = round(fault.value)
            case FaultKind.OFF_BODY:
                self._worn = False
            case FaultKind.DRIFT:
                self._drift_ppm = fault.value
                self._crystal.set_drift(fault.value)

    def _end(self, kind: FaultKind) -> None:
        match kind:
            case FaultKind.DROP:
                self._peripheral.restore()
            case FaultKind.STALL:
                self._peripheral.stalled = False
            case FaultKind.REFUSE:
                self._firmware.refuses = False
            case FaultKind.LATE:
                self._answer_delay_s = 0.0
            case FaultKind.OFF_BODY:
                self._worn, self._worn_since_s = True, self.world.clock()
            case _:
                self._power.release(kind)

    async def _power_on(self) -> None:
        self._crystal = Crystal(self.world.clock, self._drift_ppm)
        # Only a writing host is told apart; the vendor's services are not advertised.
        commands = Characteristic[bytes](
            COMMAND_UUID,
            _Properties.WRITE | _Properties.WRITE_WITHOUT_RESPONSE,
            Attribute.Permissions.WRITEABLE,
            CharacteristicValue(write=self._hear),
        )
        await self._peripheral.power_on([Service(SERVICE_UUID, [commands, self._response])])

    async def _power_off(self) -> None:
        self._lose_host()
        await self._peripheral.power_off()

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
            self._stop_measuring()
            self._measuring = self._run(self._measure())
        elif not self._firmware.mask:
            self._stop_measuring()

    async def _measure(self) -> None:
        """Send packets of samples; the first sample is taken at the start itself."""
        period_s = self._firmware.period_us / 1e6
        count = max(1, round(PACKET_S / period_s))
        begin_s = self._crystal.now()
        started_s = self.world.clock()
        first = 0
        while True:
            device_times = begin_s + (first + np.arange(count)) * period_s
            await self._crystal.reach(float(device_times[-1]))
            times = np.array([self._crystal.true_time(float(time)) for time in device_times])
            if self._jitter_s:
                await asyncio.sleep(self._rng.uniform(0, self._jitter_s))
            rows = self._rows(times, started_s)
            mask = self._firmware.mask
            if not mask:
                return
            columns = [channel for channel in range(rows.shape[1]) if mask & (1 << channel)]
            sent = await self._send(self._firmware.pack(rows[:, columns]))
            self._note(times, rows, mask, sent=sent)
            first += count

    def _rows(self, times: NDArray[np.float64], started_s: float) -> NDArray[np.float32]:
        """Values of channels 0 to 5 at some LSL times."""
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
        # The belt's own rate is a little off, differently each time.
        error = 0.3 * math.sin(1.7 * updates)
        return round(self._wearer.respiration_rate_bpm + error, 1)

    def _note(
        self, times: NDArray[np.float64], rows: NDArray[np.float32], mask: int, *, sent: bool
    ) -> None:
        for channel, data_name in ((1, "force"), (2, "bpm")):
            if not mask & (1 << channel):
                continue
            if sent:
                values = rows[:, channel : channel + 1].astype(np.float64)
                self.truth.sent(data_name, times.tolist(), values.tolist())
            else:
                self.truth.unsent(data_name, len(times))

    async def _send(self, packet: bytes) -> bool:
        """Send a packet in as many notifications as it takes; False if the host misses any."""
        size = max(_FRAGMENT_BYTES, self._peripheral.host_mtu - 3)
        sent = True
        # Packets must not mix on the air.
        async with self._sending:
            for begin in range(0, len(packet), size):
                fragment = packet[begin : begin + size]
                sent = await self._peripheral.notify(self._response, fragment) and sent
        return sent

    async def _send_garbage(self, count: int) -> None:
        for begin in range(0, count, _GARBAGE_BYTES):
            noise = self._rng.bytes(min(_GARBAGE_BYTES, count - begin))
            await self._peripheral.notify(self._response, noise)

    def _break_link(self) -> None:
        self._peripheral.drop()
        self._peripheral.restore()

    def _note_signal(self) -> None:
        self.truth.sent("rssi", [self.world.clock()], [(self._rssi_dbm,)])

    def _lose_host(self) -> None:
        self._stop_measuring()
        for task in self._tasks:
            task.cancel()
        self._firmware.forget()

    def _stop_measuring(self) -> None:
        if self._measuring is not None:
            self._measuring.cancel()
            self._measuring = None

    def _run(self, coroutine: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
