"""Base class of virtual Shimmers with LogAndStream firmware, on a serial port."""

from __future__ import annotations

import asyncio
import sys
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from types import MappingProxyType
from typing import Any, ClassVar, Unpack

import numpy as np

from biosensor_gateway.devices.shimmer.simulator import wire
from biosensor_gateway.devices.shimmer.simulator.interpreter import Interpreter
from biosensor_gateway.devices.shimmer.simulator.sampler import (
    Meter,
    Sample,
    Sampling,
    Streams,
    samples,
)
from biosensor_gateway.devices.shimmer.simulator.wire import (
    NACK,
    TICKS_PER_S,
    Command,
    CommandReader,
    Firmware,
    Flash,
    Memory,
    Opcode,
    channels_of,
    in_unknown_kind,
    sealed,
)
from biosensor_gateway.simulation.async_serial import PatientPort
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    glued,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import Link, SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World

_TX_QUEUE_BYTES = 256
_UNREACHABLE = frozenset({FaultKind.DROP, FaultKind.RESTART})

_AT_CHANGES = "quality"


class _Notes:
    """Records samples in the truth: all of them, but ``quality`` only at changes."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._quality: tuple[float, ...] = ()

    def sent(self, sample: Sample) -> None:
        """Record a sample that was sent."""
        for name, values in sample.values.items():
            if name != _AT_CHANGES:
                self._truth.sent(name, [sample.measured_s], [values])
            elif not np.array_equal(values, self._quality, equal_nan=True):
                self._quality = values
                self._truth.sent(name, [sample.measured_s], [values])

    def kept_back(self, sample: Sample) -> None:
        """Record a sample that was measured but not sent."""
        for name in sample.values.keys() - {_AT_CHANGES}:
            self._truth.unsent(name, 1)


class Conversation:
    """Answers commands in order and, as a fault, late or with refusals.

    Parameters
    ----------
    write
        Sends bytes; returns whether the link accepted them.
    obeyed
        Called after each executed command and its answer, with whether the link accepted it.
    """

    def __init__(
        self,
        firmware: Firmware,
        interpreter: Interpreter,
        write: Callable[[bytes], bool],
        obeyed: Callable[[Opcode, bool], None],
    ) -> None:
        self._firmware = firmware
        self._interpreter = interpreter
        self._write = write
        self._obeyed = obeyed
        self.refusing = False
        self.denied: Opcode | None = None  # The command that is refused, if any.
        self.answer_delay_s = 0.0
        self._reader = CommandReader(firmware)
        self._spoken_to = False
        self._delayed: list[asyncio.TimerHandle] = []

    @property
    def spoken_to(self) -> bool:
        """Whether the host has sent anything; before that, the device is silent."""
        return self._spoken_to

    def hear(self, data: bytes) -> None:
        """Process the host's bytes."""
        self._spoken_to = True
        for command in self._reader.feed(data):
            if self.answer_delay_s:
                loop = asyncio.get_running_loop()
                self._delayed.append(loop.call_later(self.answer_delay_s, self._carry_out, command))
            else:
                self._carry_out(command)

    def say(self, message: bytes) -> bool:
        """Send a message with its checksum; return whether the link accepted it."""
        return self._write(sealed(message, self._interpreter.crc_bytes))

    def dock(self, *, docked: bool) -> None:
        """Dock or undock the device, which sends its status."""
        self._interpreter.docked = docked
        if self._spoken_to:
            self.say(self._interpreter.pushed_status())

    def link_lost(self) -> None:
        """Reset the link's settings and discard outstanding answers."""
        for handle in self._delayed:
            handle.cancel()
        self._delayed.clear()
        self._spoken_to = False
        self._reader = CommandReader(self._firmware)
        self._interpreter.link_lost()

    def _carry_out(self, command: Command) -> None:
        if not self.refusing and command.opcode is not self.denied:
            taken = self.say(self._interpreter.execute(command))
            self._obeyed(command.opcode, taken)
        elif self._firmware.has_nack:  # older firmware refuses silently
            self.say(NACK)


class SimulatedShimmer(VirtualDevice):
    """A unit without sensors.

    Its `truth` contains the data of its packets, and ``bat`` [percent] of each answer about the
    battery.

    Parameters
    ----------
    name
        Name of the radio; the unit's own name contains its last four characters.
    firmware
        Version of LogAndStream, such as 0.11.0, 0.16.11 or 1.1.2.
    first_tick
        Tick count at the first power-on; data packets contain its low 24 bits.
    tcp
        Use a TCP server instead of a pseudo-terminal; default on systems without one.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    link = Link.SERIAL
    memory: ClassVar[Memory]
    """Memory as written in the factory."""
    deniable: ClassVar[Sequence[Opcode]] = (Opcode.GET_BATTERY,)
    """Commands that are refused, one at a time."""
    usual_name: ClassVar[str] = "Shimmer3-4E5F"

    def __init__(
        self,
        world: World,
        *,
        name: str | None = None,
        firmware: tuple[int, int, int] = (1, 1, 2),
        battery_percent: float = 80.0,
        first_tick: int = 0,
        tcp: bool = sys.platform == "win32",
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        self.name = name or self.usual_name
        self.wearer = self.specimen.wearer
        self.firmware = Firmware(*firmware)
        self._flash = self._new_flash(f"Shimmer_{self.name[-4:]}")
        self._interpreter = Interpreter(
            self.firmware, self._flash, self.ticks, self.battery_counts, self.memory
        )
        self._conversation = Conversation(
            self.firmware, self._interpreter, self._write, self._obeyed
        )
        self._rng = np.random.default_rng(self.specimen.seed)
        self._battery_percent = battery_percent
        self._first_tick = first_tick
        self._tcp = tcp
        self._oscillator = Oscillator(world.clock, self.specimen.drift_ppm)
        self._started_s = self.world.clock()
        self._port: PatientPort | None = None
        self._notes = _Notes(self.truth)
        self._streams = Streams(world.clock, self._send, self._notes.kept_back)
        self._worn = True
        self._to_deny = cycle(self.deniable)
        self._stalled = self._is_unreadable = False

    @property
    def port(self) -> str:
        """Name of its serial port for the host; it stays the same after lost links."""
        if self._port is None:
            raise RuntimeError("the virtual Shimmer is not switched on")
        return self._port.name

    @property
    def settings(self) -> Mapping[str, Any]:
        """The setting ``port``."""
        return {"port": self.port}

    @property
    def streaming(self) -> bool:
        """Whether it is streaming."""
        return self._interpreter.sensing

    @property
    def started_s(self) -> float:
        """LSL time at which the wearer's time is 0."""
        return self._started_s

    def dock(self, *, docked: bool = True) -> None:
        """Dock or undock it, which sends its status."""
        self.world.call(lambda: self._conversation.dock(docked=docked))

    def ticks(self) -> int:
        """Ticks of 1/32768 s since power-on."""
        return int(self._oscillator.now() * TICKS_PER_S) + self._first_tick

    def battery_counts(self) -> int:
        """Return the battery voltage in ADC counts."""
        return wire.counts_at(self._battery_percent)

    async def _start(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._started_s = self.world.clock()
        self._port = PatientPort(
            self._heard, self._link_lost, buffer_bytes=_TX_QUEUE_BYTES, tcp=self._tcp
        )
        self._port.open()

    async def _stop(self) -> None:
        self._link_lost()
        if self._port is not None:
            self._port.dispose()

    def _break_link(self) -> None:
        self._hang_up()
        self._reopen()

    def _hang_up(self) -> None:
        self._link_lost()
        if self._port is not None:
            self._port.hang_up()

    def _reopen(self) -> None:
        if self._port is not None and not _UNREACHABLE & self._lasting.keys():
            self._port.open()

    def _link_lost(self) -> None:
        self._conversation.link_lost()
        self._streams.cut()

    def _heard(self, data: bytes) -> None:
        if not self._stalled:
            self._conversation.hear(data)

    def _obeyed(self, opcode: Opcode, answered: bool) -> None:
        if opcode is Opcode.GET_BATTERY and answered:
            percent = wire.percent_of(self.battery_counts())
            self.truth.sent("bat", [self.world.clock()], [[percent]])
        self._follow_sensing()

    def _follow_sensing(self) -> None:
        if not self._interpreter.sensing:
            self._streams.stop()
        elif not self._streams.running:
            self._streams.start(samples(self._sampling()))

    @abstractmethod
    def _meter(self, channels: tuple[int, ...]) -> Meter:
        """Return the sensors of these channels, for a stream that starts now."""

    def _new_flash(self, name: str) -> Flash:
        """Return the initial setup of the unit."""
        return Flash(name)

    def _sampling(self) -> Sampling:
        channels = channels_of(self._flash.sensors, self.memory.model)
        return Sampling(
            channels,
            self._flash.divider,
            self._meter(channels),
            self._started_s,
            self._oscillator,
            self._first_tick,
            self._rng,
            self.specimen.jitter_s,
            self.memory.model,
        )

    def _send(self, sample: Sample) -> None:
        if self._is_unreadable:
            self._conversation.say(in_unknown_kind(sample.packet))
            self._notes.kept_back(sample)
        elif self._conversation.say(sample.packet):
            self._notes.sent(sample)
        else:
            self._notes.kept_back(sample)

    def _write(self, data: bytes) -> bool:
        return self._port is not None and not self._stalled and self._port.write(data)

    def _babble(self, count: float) -> None:
        if self._conversation.spoken_to:
            self._write(self._rng.bytes(int(count)))

    def _deny(self) -> None:
        self._conversation.denied = next(self._to_deny)
        self._break_link()

    def _give(self) -> None:
        self._conversation.denied = None

    def _be_docked(self, count: float) -> None:
        for number in range(int(count)):
            self._conversation.dock(docked=number % 2 == 0)

    def _forget(self, _: float) -> None:
        self._interpreter.sensing = False
        self._follow_sensing()

    def _power_cycle(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._oscillator.drift_ppm)
        self._first_tick = 0
        self._interpreter.power_on()
        self._reopen()

    effects = MappingProxyType(
        {
            Untidiness.GLUED: glued("_port"),
            FaultKind.DROP: lasting(_hang_up, _reopen),
            FaultKind.RESTART: lasting(_hang_up, _power_cycle),
            FaultKind.STALL: flag("_stalled"),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.REFUSE: flag("_conversation.refusing", then=_break_link),
            FaultKind.LATE: level("_conversation.answer_delay_s", 0.0, then=_break_link),
            FaultKind.DENY: lasting(_deny, _give),
            FaultKind.FORGET: Effect(_forget),
            Untidiness.STRAY: Effect(_be_docked),
            FaultKind.UNREADABLE: flag("_is_unreadable"),
            FaultKind.LOW_BATTERY: level("_battery_percent"),
            FaultKind.OFF_BODY: flag("_worn", False),
            **on_part("_oscillator", {FaultKind.DRIFT: Effect(Oscillator.set_drift)}),
        }
    )
