"""A virtual device with all supported services, from an oximeter to a bicycle."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from types import MappingProxyType
from typing import NamedTuple, Unpack

import numpy as np
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
from biosensor_gateway.simulation.faults import Effect, FaultKind, lasting, on_part
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import NO_INTERVALS
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.world import World

_NOTIFY, _INDICATE = Characteristic.Properties.NOTIFY, Characteristic.Properties.INDICATE
_ADVERTISED = ("1822", "1809", "1814", "1816", "1818")
_SERVICES = {
    "spo2": (0x1822, 0x2A5F, _NOTIFY),
    "temp": (0x1809, 0x2A1C, _INDICATE),
    "running": (0x1814, 0x2A53, _NOTIFY),
    "cycling": (0x1816, 0x2A5B, _NOTIFY),
    "power": (0x1818, 0x2A63, _NOTIFY),
}
_WHEEL_HZ, _CRANK_HZ = 2.0, 1.25

# Layouts of values: Bluetooth SIG, Pulse Oximeter Service 1.0.1, Health Thermometer Service 1.0,
# Running Speed and Cadence Service 1.0, Cycling Speed and Cadence Service 1.0, Cycling Power
# Service 1.1.
_NO_NUMBER = 0x07FF
_STATUS_AND_AMPLITUDE = 0x18
_UNCONNECTED_TO_USER = 1 << 11
# Exponent -1, placed above a 12-bit mantissa.
_TENTHS = 0xF000


def _tenths(value: float) -> int:
    """Return a 16-bit decimal number with one decimal place."""
    return _TENTHS | round(10 * value) & 0x0FFF


def _oximeter(spo2: float, pulse: float, amplitude: float, *, worn: bool) -> bytes:
    """Return a continuous measurement with device status and pulse amplitude index."""
    status = 0 if worn else _UNCONNECTED_TO_USER
    numbers = [_tenths(each) if worn else _NO_NUMBER for each in (spo2, pulse, amplitude)]
    head = struct.pack("<BHH", _STATUS_AND_AMPLITUDE, *numbers[:2])
    return head + status.to_bytes(3, "little") + struct.pack("<H", numbers[2])


def _thermometer(celsius: float) -> bytes:
    """Return a temperature with two decimal places."""
    mantissa = round(100 * celsius) & 0xFFFFFF
    return struct.pack("<BI", 0, mantissa | (-2 & 0xFF) << 24)


def _foot_pod(metres_per_second: float, strides_per_minute: int) -> bytes:
    """Return a runner's speed and cadence."""
    return struct.pack("<BHB", 4, round(256 * metres_per_second), strides_per_minute)


def _bicycle(wheel_turns: int, wheel_s: float, crank_turns: int, crank_s: float) -> bytes:
    """Return counted revolutions, and the times of the last ones."""
    times = [round(1024 * each) & 0xFFFF for each in (wheel_s, crank_s)]
    counts = wheel_turns & 0xFFFFFFFF, times[0], crank_turns & 0xFFFF, times[1]
    return struct.pack("<BIHHH", 3, *counts)


def _power_meter(watts: int) -> bytes:
    """Return a measurement with power only."""
    return struct.pack("<Hh", 0, watts)


EXPECTED = replace(
    ANY_STRAP,
    without_contact=("spo2",),
    # The agent calculates speed and cadence from counted revolutions.
    by_agent=frozenset({"quality", "cycling"}),
    impossible={**ANY_STRAP.impossible, FaultKind.REPEAT: NO_INTERVALS},
    unstamped_s={"spo2": 0.0, "temp": 0.0, "running": 0.0, "power": 0.0},
)


class _Value(NamedTuple):
    """A value to send, and the sample that it makes; None if it makes none."""

    data_name: str
    data: bytes
    sample: tuple[float, ...] | None


class SimulatedHealthDevice(StrapDevice):
    """A device with all supported services, which notifies each once a second.

    Parameters
    ----------
    world, radio
        Simulated world and radio.
    address, name
        As advertised.
    rssi_dbm
        Signal strength as received.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    sensor = "bluetooth_health"
    each_own = MappingProxyType(
        {"address": "C8:26:00:00:01:{number:02X}", "name": "Health Device {next:04}"}
    )
    expected = EXPECTED
    on_air = True

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "C8:26:00:00:00:01",
        name: str = "Health Device 0001",
        rssi_dbm: int = -63,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self._stepped_back = 0
        self.device = address
        self._strap = Strap(
            Peripheral(radio, address, name, service_uuids=_ADVERTISED, rssi_dbm=rssi_dbm),
            self.truth,
            self.specimen,
            identity=Identity("Virtual Health", "Health Device", "0001", firmware="1.0"),
        )
        # This device is not a heart-rate strap.
        self._strap.services.remove(self._strap.heart_rate.service)
        self._characteristics = {name: self._add(*each) for name, each in _SERVICES.items()}
        self._strap.deny_by_turns(list(self._characteristics.values()))
        self._strap.on_power_on.append(self._begin)

    def _add(
        self, service: int, number: int, properties: Characteristic.Properties
    ) -> Characteristic[bytes]:
        characteristic = Characteristic[bytes](
            UUID.from_16_bits(number), properties, Attribute.Permissions.READABLE, b""
        )
        self._strap.services.append(Service(UUID.from_16_bits(service), [characteristic]))
        return characteristic

    def _begin(self) -> None:
        self._strap.run(self._measure())

    async def _measure(self) -> None:
        for second in count(1):
            measured_s = await self._strap.oscillator.reach(second)
            for value in self._values(second, measured_s):
                # Each value has its own radio delay.
                self._strap.run(self._send(value, measured_s))

    def _values(self, second: int, measured_s: float) -> Iterator[_Value]:
        wearer = self._strap.wearer
        t = np.array([measured_s - self._strap.origin_s])
        spo2 = round(97.0 + float(wearer.noise(t, 0.4, "spo2")[0]), 1)
        pulse, amplitude = round(float(wearer.heart_rate(t)[0]), 1), 3.4
        celsius = round(float(wearer.skin_temperature_c(t)[0]) + 4.0, 2)
        speed = round(256 * (2.8 + float(wearer.noise(t, 0.1, "speed")[0]))) / 256
        watts = round(180 + float(wearer.noise(t, 20.0, "power")[0]))
        worn = self._strap.worn
        sample = (spo2, pulse, amplitude) if worn else None
        yield _Value("spo2", _oximeter(spo2, pulse, amplitude, worn=worn), sample)
        yield _Value("temp", _thermometer(celsius), (celsius,))
        yield _Value("running", _foot_pod(speed, 82), (speed, 82.0))
        wheel, crank = int(second * _WHEEL_HZ), int(second * _CRANK_HZ)
        counted = [each - self._stepped_back for each in (wheel, crank)]
        turns = _bicycle(counted[0], wheel / _WHEEL_HZ, counted[1], crank / _CRANK_HZ)
        yield _Value("cycling", turns, None)
        yield _Value("power", _power_meter(watts), (float(watts),))

    async def _send(self, value: _Value, measured_s: float) -> None:
        characteristic = self._characteristics[value.data_name]
        expected = self._strap.peripheral.subscribed(characteristic)
        is_readable = not self._strap.is_unreadable
        data = value.data if is_readable else value.data[:2]
        sent = await self._strap.send(characteristic, data) and is_readable
        if value.sample is not None and sent:
            self.truth.sent(value.data_name, [measured_s], [value.sample])
        elif value.sample is not None and expected:
            self.truth.unsent(value.data_name, 1)

    def _babble(self, packets: float) -> None:
        self._strap.run(self._send_garbage(round(packets)))

    async def _send_garbage(self, packets: int) -> None:
        names = list(self._characteristics)
        for number in range(packets):
            characteristic = self._characteristics[names[number % len(names)]]
            await self._strap.peripheral.notify(characteristic, b"\x1f")

    def _step_back(self, turns: float) -> None:
        self._stepped_back += round(turns)

    def _forget(self, _: float) -> None:
        for characteristic in self._characteristics.values():
            self._strap.peripheral.forget_subscription(characteristic)

    effects = MappingProxyType(
        {
            **on_part("_strap", STRAP_EFFECTS),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.STEP_BACK: Effect(_step_back),
            **on_part("_strap", {FaultKind.DENY: lasting(Strap.deny, Strap.allow)}),
        }
    )
