"""Virtual boards with an accelerometer and electrodes for skin conductance."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np

from biosensor_gateway.devices.line_sensor import (
    EXAMPLE_COLUMNS,
    EXAMPLE_COUNTS,
    EXAMPLE_RATE_HZ,
    EXAMPLE_TELLS_TIME,
    NAME,
)
from biosensor_gateway.devices.line_sensor.simulator.ways import (
    OpenEarableApp,
    Serial,
    Udp,
    Way,
    WebSocket,
)
from biosensor_gateway.simulation.faults import (
    Effect,
    Effects,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    on_part,
)
from biosensor_gateway.simulation.truth import NO_INTERVALS, Expected, Gap, LossTolerance
from biosensor_gateway.simulation.virtual_device import Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World

_DIGITS = 4
_NO_COMMANDS = "it takes no command and sends all the time"
_NO_STATE = "its lines say nothing of it"

MICROS_TURN = 1 << 32
"""Overflow of an Arduino's ``micros()``."""

_RECORD = struct.Struct("<IIffff")
_RECORD_START = b"\xaa\x55"
RECORD_FORMAT = "<IIffff"


class Measured(NamedTuple):
    """One measurement of a board."""

    number: int  # Number of the measurement since power-on.
    micros: int  # Device time in microseconds.
    # acc_g, gsr_us: values as sent, in g and microsiemens.
    acc_g: tuple[float, float, float]
    gsr_us: float

    @property
    def numbers(self) -> tuple[float, ...]:
        """All values in the order of the columns."""
        return (self.number, self.micros % MICROS_TURN, *self.acc_g, self.gsr_us)


def _csv_line(measured: Measured) -> bytes:
    """Return comma-separated values with the line end of ``Serial.println``."""
    number, micros, *values = measured.numbers
    return f"{number},{micros},{','.join(f'{each:.4f}' for each in values)}\r\n".encode()


def _json_line(measured: Measured) -> bytes:
    """Return a JSON object with a nested object."""
    number, micros, x, y, z, gsr = measured.numbers
    said = {"n": number, "t": micros, "acc": {"x": x, "y": y, "z": z}, "gsr": gsr}
    return json.dumps(said, separators=(",", ":")).encode() + b"\n"


def _record(measured: Measured) -> bytes:
    """Return two start bytes, a packed C struct, and the CRC of its values."""
    values = _RECORD.pack(*measured.numbers)
    return _RECORD_START + values + struct.pack("<H", crc16(values))


def crc16(data: bytes) -> int:
    """Compute CRC-16 with polynomial 0x1021 and start value 0xFFFF, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x1021 if crc & 0x8000 else 0)
            crc &= 0xFFFF
    return crc


class SimulatedLineSensor(VirtualDevice):
    """Sends comma-separated lines on a serial port, 100 per second.

    Parameters
    ----------
    **specimen
        As for every virtual device: see `Specimen`. Lines stay in order.
    """

    sensor = NAME
    link = Link.SERIAL
    expected = Expected(
        gaps={FaultKind.RESTART: Gap.STOPPED},
        # A restarted board restarts its count, so lines in transit are not counted as lost.
        loss_tolerance=LossTolerance(over_break=1, over_restart={"acc": 25, "gsr": 25}),
        impossible={
            FaultKind.REFUSE: _NO_COMMANDS,
            FaultKind.LATE: _NO_COMMANDS,
            FaultKind.FORGET: _NO_COMMANDS,
            FaultKind.LOW_BATTERY: _NO_STATE,
            FaultKind.OFF_BODY: _NO_STATE,
            FaultKind.DENY: _NO_COMMANDS,
            FaultKind.REPEAT: NO_INTERVALS,
            FaultKind.STEP_BACK: "if its counter steps back, it was restarted",
        },
    )
    format_settings: ClassVar[Mapping[str, Any]] = MappingProxyType({"format": "csv"})

    def __init__(self, world: World, **specimen: Unpack[SpecimenOptions]) -> None:
        super().__init__(world, **specimen)
        self._rng = np.random.default_rng(self.specimen.seed)
        self._oscillator = Oscillator(world.clock, self.specimen.drift_ppm)
        self._way: Way | None = None
        self._measuring: asyncio.Task[None] | None = None
        self._opening: asyncio.Task[None] | None = None
        self._is_stalled, self._is_otherwise = False, False
        self._rate_hz = EXAMPLE_RATE_HZ

    def _make_way(self) -> Way:
        return Serial()

    @staticmethod
    def _written(measured: Measured) -> bytes:
        return _csv_line(measured)

    @property
    def settings(self) -> Mapping[str, Any]:
        """Its address and the format of its lines."""
        assert self._way is not None
        return {
            **self._way.settings,
            **self.format_settings,
            "columns": list(EXAMPLE_COLUMNS),
            "sequence_column": EXAMPLE_COUNTS,
            "time_column": EXAMPLE_TELLS_TIME,
            "rate_hz": EXAMPLE_RATE_HZ,
        }

    async def _start(self) -> None:
        self._way = self._make_way()
        await self._way.open()
        self._switch_on()

    async def _stop(self) -> None:
        self._switch_off()
        if self._opening is not None:
            self._opening.cancel()
        if self._way is not None:
            self._way.dispose()

    def _switch_on(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._measuring = asyncio.create_task(self._measure())

    def _switch_off(self) -> None:
        if self._measuring is not None:
            self._measuring.cancel()

    async def _measure(self) -> None:
        """Measure at each tick of the oscillator; a late measurement delays the next ones."""
        count, due_s = 0, 0.0
        while True:
            device_s = count / self._rate_hz
            time_s = await self._oscillator.reach(device_s)
            due_s = max(due_s, time_s + self.specimen.jitter_s * self._rng.random())
            left_s = due_s - self.world.clock()
            if left_s > 0:
                await asyncio.sleep(left_s)
            self._send(self._look(count, device_s, time_s), time_s)
            count += 1

    def _look(self, count: int, device_s: float, time_s: float) -> Measured:
        times = np.array([time_s], np.float64)
        acc = self.specimen.wearer.acceleration_g(times)[0].round(_DIGITS)
        gsr = self.specimen.wearer.skin_conductance_us(times)[0].round(_DIGITS)
        x, y, z = (float(each) for each in acc)
        return Measured(count, round(device_s * 1e6), (x, y, z), float(gsr))

    def _send(self, measured: Measured, time_s: float) -> None:
        data = self._written(measured)
        if self._is_otherwise:
            # An unknown format, as from a different version of the sketch.
            data = bytes(each ^ 0x15 if each > ord(" ") else each for each in data)
        taken = not self._is_stalled and self._way is not None and self._way.write(data)
        if taken and not self._is_otherwise:
            self.truth.sent("acc", [time_s], [measured.acc_g])
            self.truth.sent("gsr", [time_s], [[measured.gsr_us]])
        elif not taken:
            self.truth.unsent("acc", 1)
            self.truth.unsent("gsr", 1)

    def _hang_up(self) -> None:
        if self._way is not None:
            self._way.hang_up()

    def _reopen(self) -> None:
        if self._way is not None:
            self._opening = asyncio.create_task(self._way.open())

    def _go_down(self) -> None:
        self._switch_off()
        self._hang_up()

    def _come_up(self) -> None:
        self._reopen()
        self._switch_on()

    def _babble(self, count: float) -> None:
        """Send a log line like an ESP32, with bytes of a wrong baud rate."""
        noise = bytes(0x80 | each for each in self._rng.bytes(int(count)))
        if self._way is not None:
            self._way.write(b"E (4711) wifi:" + noise + b"\r\n")

    def make_untidy(self, kind: Untidiness, *, on: bool) -> None:
        """Switch a disturbance of its link on or off."""
        if self._way is not None:
            self._way.make_untidy(kind, on=on)

    def _glue(self) -> None:
        self.make_untidy(Untidiness.GLUED, on=True)

    def _unglue(self) -> None:
        self.make_untidy(Untidiness.GLUED, on=False)

    def _change_rate(self, hz: float) -> None:
        self._rate_hz = hz
        self._go_down()
        self._come_up()

    def _usual_rate(self) -> None:
        self._change_rate(EXAMPLE_RATE_HZ)

    def _greet(self, count: float) -> None:
        """Send lines of another part of the sketch, with as many numbers as a data line."""
        for _ in range(int(count)):
            if self._way is not None:
                self._way.write(self._written(Measured(0, 0, (0.1, 0.2, 0.3), 0.4)))

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_hang_up, _reopen),
            FaultKind.STALL: flag("_is_stalled"),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.UNREADABLE: flag("_is_otherwise"),
            FaultKind.RESTART: lasting(_go_down, _come_up),
            **on_part("_oscillator", {FaultKind.DRIFT: Effect(Oscillator.set_drift)}),
            Untidiness.STRAY: Effect(_greet),
            Untidiness.GLUED: lasting(_glue, _unglue),
            Untidiness.RATE: Effect(_change_rate, _usual_rate),
        }
    )


def _overtake(board: UdpLineSensor) -> None:
    board.make_untidy(Untidiness.OVERTAKEN, on=True)


def _keep_order(board: UdpLineSensor) -> None:
    board.make_untidy(Untidiness.OVERTAKEN, on=False)


def _without_glue(more: Effects[Any]) -> Effects[Any]:
    kept = {**SimulatedLineSensor.effects, **more}
    del kept[Untidiness.GLUED]
    return MappingProxyType(kept)


class UdpLineSensor(SimulatedLineSensor):
    """Sends JSON in datagrams."""

    link = Link.UDP
    effects = _without_glue({Untidiness.OVERTAKEN: lasting(_overtake, _keep_order)})

    format_settings = MappingProxyType({"format": "json"})

    def _make_way(self) -> Way:
        return Udp()

    @staticmethod
    def _written(measured: Measured) -> bytes:
        return _json_line(measured)


class WebSocketLineSensor(SimulatedLineSensor):
    """Sends JSON in WebSocket messages."""

    link = Link.WEB_SOCKET
    effects = _without_glue({})

    format_settings = MappingProxyType({"format": "json"})

    def _make_way(self) -> Way:
        return WebSocket()

    @staticmethod
    def _written(measured: Measured) -> bytes:
        return _json_line(measured)


class StructLineSensor(SimulatedLineSensor):
    """Sends binary records over TCP."""

    link = Link.TCP

    format_settings = MappingProxyType(
        {
            "format": "struct",
            "struct_format": RECORD_FORMAT,
            "frame_start": "aa55",
            "checksum": "crc16",
        }
    )

    def _make_way(self) -> Way:
        return Serial(tcp=True)

    @staticmethod
    def _written(measured: Measured) -> bytes:
        return _record(measured)


class OpenEarableLineSensor(SimulatedLineSensor):
    """A wearable in the OpenEarable app, with one sensor for all values.

    Parameters
    ----------
    wearables
        Names of the wearables connected to the app.
    exponent
        Unit of its time as a power of ten of a second.
    """

    link = Link.WEB_SOCKET
    effects = _without_glue({})

    def __init__(
        self,
        world: World,
        wearables: Sequence[str] = ("OpenEarable-0001",),
        exponent: int = -6,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        axes = {"axis_names": ["x", "y", "z", "gsr"], "axis_units": ["g", "g", "g", "uS"]}
        sensor = {"sensor_id": "chest_0", "sensor_index": 0, "name": "Chest", **axes}
        self.app = OpenEarableApp({**sensor, "timestamp_exponent": exponent}, wearables)

    def _make_way(self) -> Way:
        return self.app

    @staticmethod
    def _written(measured: Measured) -> bytes:
        values = [*measured.acc_g, measured.gsr_us]
        said = {"timestamp": measured.micros, "value_strings": [str(each) for each in values]}
        return json.dumps({**said, "values": values}).encode()

    @property
    def settings(self) -> Mapping[str, Any]:
        """URL of the app and sensor to subscribe to, without a count column."""
        counted = {**super().settings, "sequence_column": "", "format": "json"}
        return {**counted, "columns": list(EXAMPLE_COLUMNS[1:]), "openearable_sensor": "Chest"}
