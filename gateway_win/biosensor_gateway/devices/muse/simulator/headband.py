"""Base class of virtual headbands: power, commands and answers, faults, and expected results.

Sources: muse-lsl (`constants.py`, `muse.py`), muse-js (`muse-utils.ts`) and OpenMuse (`muse.py`)
for UUIDs, framing and the fields of answers.
"""

from __future__ import annotations

import asyncio
import json
from abc import abstractmethod
from collections.abc import Coroutine, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from types import MappingProxyType
from typing import Any, ClassVar, Unpack

import numpy as np
from bumble.att import Attribute
from bumble.core import UUID
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

from biosensor_gateway.simulation.faults import Effect, FaultKind, Untidiness, flag, level
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.radio_device import RadioDevice
from biosensor_gateway.simulation.truth import (
    NO_INTERVALS,
    ONE_RATE,
    USUALLY_IMPOSSIBLE,
    Expected,
    Gap,
    LossTolerance,
)
from biosensor_gateway.simulation.virtual_device import SpecimenOptions
from biosensor_gateway.simulation.wearer import Floats, Wearer
from biosensor_gateway.simulation.world import World

CLASSIC = Expected(
    # The battery level has no timestamp.
    unstamped_s={"bat": 0.0},
    # Counters restart with each connection, so its start is only known by the arrival.
    loss_tolerance=LossTolerance(over_break=48, by_arrival=True),
    impossible={
        FaultKind.OFF_BODY: "it does not report whether it is worn",
        FaultKind.REPEAT: NO_INTERVALS,
        Untidiness.RATE: ONE_RATE,
        Untidiness.APART: "packets are sent in the order of their electrodes, so a missing "
        "one is a loss",
    },
)
ATHENA = replace(
    CLASSIC,
    unstamped_s={},
    impossible={
        **CLASSIC.impossible,
        Untidiness.APART: USUALLY_IMPOSSIBLE[Untidiness.APART],
        FaultKind.DENY: "one characteristic carries all measurements",
    },
    # Counters restart with each connection, so its start is only known by the device's clock.
    loss_tolerance=LossTolerance(over_break=48),
    # The device's clock restarts.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)


SERVICE = "fe8d"
_BASE = "273e{:04x}-4c4d-454d-96be-f03bac821358"
_PIECE_BYTES = 20


def uuid(number: int) -> str:
    """Return the UUID of a characteristic from its variable part."""
    return _BASE.format(number)


CONTROL = uuid(0x0001)


def command_text(written: bytes) -> str | None:
    """Return the command in written data; None if it is invalid."""
    if len(written) < 2 or written[0] != len(written) - 1 or written[-1:] != b"\n":
        return None
    return written[1:-1].decode("ascii", "replace")


def pieces(
    answers: Iterable[Mapping[str, object]], cuts: np.random.Generator | None = None
) -> Iterator[bytes]:
    """Split answers into notifications: number of characters, characters, zero padding.

    Parameters
    ----------
    answers
        Answers in sequence.
    cuts
        For pieces of random length; None for full pieces.
    """
    text = b"".join(json.dumps(each, separators=(",", ":")).encode("ascii") for each in answers)
    room = _PIECE_BYTES - 1
    while text:
        length = room if cuts is None else int(cuts.integers(1, room, endpoint=True))
        piece, text = text[:length], text[length:]
        yield bytes((len(piece),)) + piece.ljust(room, b"\0")


def version(firmware: str, protocol: int) -> dict[str, object]:
    """Return the answer about the firmware."""
    return {
        "ap": "headset",
        "sp": "RevE",
        "tp": "consumer",
        "hw": "3.1",
        "bn": 27,
        "fw": firmware,
        "bl": "1.2.3",
        "pv": protocol,
        "rc": 0,
    }


def status(name: str, serial: str, percent: float, preset: str) -> dict[str, object]:
    """Return the answer about the state."""
    return {
        "hn": name,
        "sn": serial,
        "ma": "00-55-da-b0-3a-1f",
        "id": "06473435 32313630 00280034",
        "bp": round(percent, 2),
        "ts": 0,
        "ps": int(preset[1:], 16),
        "rc": 0,
    }


_P = Characteristic.Properties
_REFUSED = 1

_LIGHT = {
    # Level, relative pulse amplitude, and noise [counts].
    "ambient": (4000.0, 0.0, 12.0),
    "infrared": (150_000.0, 2500.0, 20.0),
    "red": (90_000.0, 900.0, 20.0),
}


class _Signals:
    """The wearer's signals at true times on the LSL clock."""

    def __init__(self, wearer: Wearer) -> None:
        self.origin_s = 0.0  # LSL time at which the wearer's time is 0.
        self._wearer = wearer

    def eeg_uv(self, times: Floats, electrode: str) -> Floats:
        """Voltage of an electrode [uV]."""
        return self._wearer.eeg_uv(times - self.origin_s, electrode)

    def light(self, times: Floats, colour: str) -> Floats:
        """Light reflected by the skin [counts]."""
        level, share, noise = _LIGHT[colour]
        t = times - self.origin_s
        return level + share * self._wearer.pulse(t) + self._wearer.noise(t, noise, colour)

    def acceleration_g(self, times: Floats) -> Floats:
        """Acceleration [g], shape (n, 3)."""
        return self._wearer.acceleration_g(times - self.origin_s)

    def rotation_dps(self, times: Floats) -> Floats:
        """Rate of rotation [deg/s], shape (n, 3)."""
        t = times - self.origin_s
        return np.stack([self._wearer.noise(t, 0.5, f"gyro{axis}") for axis in "xyz"], axis=1)


class HeadbandOptions(SpecimenOptions, total=False):
    """The parameters of a `Headband`, for constructors that pass them on."""

    address: str
    serial: str
    rssi_dbm: int
    patience_s: float


class Headband(RadioDevice):
    """A headband with its radio, which streams on command.

    Parameters
    ----------
    world, radio
        Simulated world and radio.
    address
        Bluetooth address; its last four digits form the name.
    serial
        Serial number; its first digit identifies the model. Both as usual by default.
    rssi_dbm
        Signal strength as received.
    patience_s
        Time without a command after which it ends the stream.
    **specimen
        As for every virtual device: see `Specimen`.
    """

    sensor = "muse"
    on_air = True
    kind: ClassVar[str]
    """Prefix of its name."""
    protocol: ClassVar[int]
    """Protocol version."""
    start: ClassVar[str]
    """The command that begins the stream."""
    presets: ClassVar[frozenset[str]]
    usual: ClassVar[tuple[str, str]]
    """Its address and serial number."""
    sends_on: ClassVar[Sequence[str]]
    """UUIDs of the characteristics that notify."""
    deniable: ClassVar[Sequence[str]] = ()
    """Characteristics that are refused, one at a time."""

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "",
        serial: str = "",
        rssi_dbm: int = -57,
        patience_s: float = 120.0,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        address = address or self.usual[0]
        self.device = address.replace(":", "")[-4:]
        name = f"{self.kind}-{self.device}"
        super().__init__(
            world,
            Peripheral(radio, address, name, service_uuids=[SERVICE], rssi_dbm=rssi_dbm),
            **specimen,
        )
        self._serial = serial or self.usual[1]
        self._signals = _Signals(self.specimen.wearer)
        self._patience_s = patience_s
        self._percent, self._preset = 87.0, "p21"
        self._to_deny = cycle(self.deniable)
        self._refuses = self._is_unreadable = self._glues = False
        self._measuring: list[asyncio.Task[None]] = []
        self._heard_s = 0.0
        self._characteristics = {
            each: Characteristic[bytes](each, _P.NOTIFY, Attribute.Permissions.READABLE, b"")
            for each in self.sends_on
        }
        self._control = Characteristic[bytes](
            CONTROL,
            _P.NOTIFY | _P.WRITE | _P.WRITE_WITHOUT_RESPONSE,
            Attribute.Permissions.READABLE | Attribute.Permissions.WRITEABLE,
            CharacteristicValue(write=self._hear),
        )

    @abstractmethod
    def _streams(self) -> Iterable[Coroutine[None, None, None]]:
        """Return the tasks that measure and send, according to the preset."""

    @abstractmethod
    def _garbage(self, number: int) -> tuple[str, bytes]:
        """Return an invalid notification and its characteristic."""

    async def _start(self) -> None:
        self._signals.origin_s = self.world.clock()
        await super()._start()

    def _services(self) -> Sequence[Service]:
        service = UUID.from_16_bits(int(SERVICE, 16))
        return [Service(service, [self._control, *self._characteristics.values()])]

    def _hear(self, _connection: Connection, written: bytes) -> None:
        self._heard_s = self.world.clock()
        self._run(self._answer(command_text(written)))

    async def _answer(self, command: str | None) -> None:
        if self._answer_delay_s:
            await asyncio.sleep(self._answer_delay_s)
        answer: Mapping[str, object] = {"rc": _REFUSED}
        if command is not None and not self._refuses:
            answer = self._carry_out(command)
        # Adds an answer, such as to a keep-alive command, in the same notification.
        answers = [answer, {"rc": 0}] if self._glues else [answer]
        cuts = self._rng if self._glues else None
        for piece in pieces(answers, cuts):
            await self._peripheral.notify(self._control, piece)

    def _carry_out(self, command: str) -> Mapping[str, object]:
        """Execute a command and return its answer."""
        if command.startswith("v"):
            return version("1.2.13", self.protocol)
        if command == "s":
            return status(self._peripheral.name, self._serial, self._percent, self._preset)
        if command in self.presets:
            self._preset = command
        elif command == "h":
            self._halt()
        elif command == self.start:
            self._halt()
            for stream in (*self._streams(), self._end_unheard()):
                self._measuring.append(self._run(stream))
        elif command != "k":
            return {"rc": _REFUSED}
        return {"rc": 0}

    async def _end_unheard(self) -> None:
        left_s = self._patience_s
        while left_s > 0:
            await asyncio.sleep(left_s)
            left_s = self._heard_s + self._patience_s - self.world.clock()
        self.break_link()

    async def _leave(self, measured_s: float, before_s: float) -> float:
        """Wait for the radio, after the previous packet; return the time of sending."""
        due_s = max(before_s, measured_s + self._rng.uniform(0, self.specimen.jitter_s))
        await asyncio.sleep(max(0.0, due_s - self.world.clock()))
        return due_s

    async def _notify(self, uuid: str, value: bytes) -> bool:
        """Send a value; return False if the host does not get it or cannot read it."""
        cut = value[:-1] if self._is_unreadable else value
        sent = await self._peripheral.notify(self._characteristics[uuid], cut)
        return sent and not self._is_unreadable

    def _note(self, name: str, times: Iterable[float], rows: Iterable[Any], *, sent: bool) -> None:
        """Record samples in declared units."""
        stamps = list(times)
        if sent:
            note = self.truth.told if name == "bat" else self.truth.sent
            note(name, stamps, [tuple(np.atleast_1d(row).tolist()) for row in rows])
        elif self._peripheral.connected:
            self.truth.unsent(name, len(stamps))

    def _halt(self) -> None:
        for task in self._measuring:
            task.cancel()
        self._measuring.clear()

    async def _send_garbage(self, amount: int) -> None:
        for number in range(amount):
            uuid, value = self._garbage(number)
            await self._peripheral.notify(self._characteristics[uuid], value)

    async def _send_answers(self, count: int) -> None:
        for _ in range(count):
            for piece in pieces([{"rc": 0}], None):
                await self._peripheral.notify(self._control, piece)

    def deny(self) -> None:
        """Break the link and refuse subscriptions to one characteristic, in turn."""
        self._peripheral.deny((UUID(next(self._to_deny)),))
        self.break_link()

    def give(self) -> None:
        """Allow all subscriptions again."""
        self._peripheral.deny(())

    def _answer_unasked(self, count: float) -> None:
        self._run(self._send_answers(round(count)))

    effects = MappingProxyType(
        {
            **RadioDevice.effects,
            FaultKind.REFUSE: flag("_refuses", then=RadioDevice.break_link),
            FaultKind.UNREADABLE: flag("_is_unreadable"),
            FaultKind.LOW_BATTERY: level("_percent"),
            Untidiness.GLUED: flag("_glues"),
            Untidiness.STRAY: Effect(_answer_unasked),
        }
    )
