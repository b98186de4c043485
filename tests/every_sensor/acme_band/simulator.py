"""A virtual Acme Band on a serial port."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from math import nan
from types import MappingProxyType
from typing import Any, Unpack

import numpy as np

from biosensor_gateway.simulation.async_serial import AsyncSerialPort, serial_port
from biosensor_gateway.simulation.faults import Effect, FaultKind, Untidiness, glued, lasting
from biosensor_gateway.simulation.truth import NO_INTERVALS, ONE_RATE, Expected
from biosensor_gateway.simulation.virtual_device import Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World

_PERIOD_S = 0.02
_ON_A_CABLE = "it knows two commands, and does as it is told"


class SimulatedAcmeBand(VirtualDevice):
    """It measures all the time, and sends while a host wants it."""

    sensor = "acme_band"
    link = Link.SERIAL
    expected = Expected(
        without_contact=("force",),
        by_agent=frozenset({"bat", "quality"}),
        impossible={
            FaultKind.REFUSE: _ON_A_CABLE,
            FaultKind.DENY: _ON_A_CABLE,
            FaultKind.LATE: _ON_A_CABLE,
            FaultKind.FORGET: _ON_A_CABLE,
            FaultKind.RESTART: _ON_A_CABLE,
            FaultKind.REPEAT: NO_INTERVALS,
            Untidiness.RATE: ONE_RATE,
            Untidiness.STRAY: "it knows one message",
        },
    )

    def __init__(self, world: World, **specimen: Unpack[SpecimenOptions]) -> None:
        super().__init__(world, **specimen)
        self._rng = np.random.default_rng(self.specimen.seed)
        self._oscillator = Oscillator(world.clock, self.specimen.drift_ppm)
        self._port: AsyncSerialPort | None = None
        self._measuring: asyncio.Task[None] | None = None
        self._sends, self._stalled, self._worn, self._battery = False, False, True, 80
        self._is_another_version = False

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``port``."""
        assert self._port is not None
        return {"port": self._port.name}

    async def _start(self) -> None:
        self._port = serial_port(self._heard, self._left, buffer_bytes=4096)
        self._port.open()
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._measuring = asyncio.create_task(self._measure(self._port))

    async def _stop(self) -> None:
        if self._measuring is not None:
            self._measuring.cancel()
        if self._port is not None:
            self._port.dispose()

    def _heard(self, data: bytes) -> None:
        self._sends = not self._stalled and data[-1:] == b"S"

    def _left(self) -> None:
        self._sends = False

    async def _measure(self, port: AsyncSerialPort) -> None:
        number = 0
        while True:
            time_s = await self._oscillator.reach(number * _PERIOD_S)
            (force,) = self.specimen.wearer.chest_force_n(np.array([time_s], np.float64))
            await asyncio.sleep(self.specimen.jitter_s * self._rng.random())
            counts = round(100 * force) if self._worn else -(2**15)
            value = counts / 100 if self._worn else nan
            taken = self._sends and not self._stalled and port.write(self._frame(number, counts))
            if taken and not self._is_another_version:
                self.truth.sent("force", [time_s], [[value]])
            number += 1

    def _frame(self, number: int, counts: int) -> bytes:
        if self._is_another_version:
            # No byte of a text is the marker: of wrong sums alone one is right by chance.
            return f"{number},{counts}\r\n".encode("ascii")
        frame = struct.pack("<BHhBB", 0xAC, number % 2**16, counts, self._worn, self._battery)
        return frame + bytes([sum(frame) % 256])

    def _hang_up(self) -> None:
        self._left()
        if self._port is not None:
            self._port.hang_up()

    def _reopen(self) -> None:
        if self._port is not None:
            self._port.open()

    def _stall(self) -> None:
        self._stalled = True

    def _resume(self) -> None:
        self._stalled = False

    def _babble(self, count: float) -> None:
        if self._port is not None:
            self._port.write(self._rng.bytes(int(count)))

    def _speak_as_another_version(self) -> None:
        self._is_another_version = True

    def _speak_as_ever(self) -> None:
        self._is_another_version = False

    def _discharge(self, percent: float) -> None:
        self._battery = round(percent)

    def _take_off(self) -> None:
        self._worn = False

    def _put_on(self) -> None:
        self._worn = True

    def _drift(self, ppm: float) -> None:
        self._oscillator.set_drift(ppm)

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_hang_up, _reopen),
            FaultKind.STALL: lasting(_stall, _resume),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.UNREADABLE: lasting(_speak_as_another_version, _speak_as_ever),
            FaultKind.LOW_BATTERY: Effect(_discharge),
            FaultKind.OFF_BODY: lasting(_take_off, _put_on),
            FaultKind.DRIFT: Effect(_drift),
            Untidiness.GLUED: glued("_port"),
        }
    )
