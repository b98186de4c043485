"""Measures the samples between two rounds of sending, and encodes them as packets.

Source: EmotiBit_XPlat_Utils, ``EmotiBitPacket`` (MIT licence).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import ceil, pi
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.faults import Effects, Untidiness, lasting
from biosensor_gateway.simulation.tcp_port import break_off
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import Oscillator

ROUND_S = 0.1
"""Interval of sending."""
SYNC_EVERY_ROUNDS = 51
BATTERY_EVERY_ROUNDS = 10
APART_EVERY_ROUNDS = 7
_DIGITS = {"eda": 6, "ppg": 0, "st": 3, "acc": 4, "gyro": 3, "mag": 2}

# Samples wait in the sensor's buffer until the processor reads them, 75 times a second; all of
# them get the processor's time of that moment, in whole milliseconds. Source:
# EmotiBit_FeatherWing, ``EmotiBit.cpp`` and ``BufferFloat.cpp``.
Floats = NDArray[np.float64]

READ_EVERY_S = 1 / 75
_PULSE_COUNTS, _PULSE_SWING = 110_000.0, 1500.0
# Relative pulse amplitude of infrared, red and green light.
_DEPTHS = (1.0, 0.6, 0.3)
LONGEST_DATAGRAM = 512
HELLO, HERE, CONNECT, PING, PONG = "HE", "HH", "EC", "PN", "PO"
DISCONNECT, NORMAL_POWER = "ED", "MN"
QUIET = frozenset({"ML", "MM"})
"""Low-power modes, in which it is connected but sends no data."""
REQUEST, TIME_LOCAL, TIME_UTC, ACKNOWLEDGED = "RD", "TL", "TU", "AK"


@dataclass(frozen=True, slots=True)
class Part:
    """A sensor."""

    data_name: str
    tags: tuple[str, ...]  # Packet tags of its channels.
    rate_hz: float
    fast_ppm: float  # Error of its own oscillator.
    # Returns values at times of the wearer, shape (n, channels), as printed in its packets.
    measure: Callable[[Wearer, Floats], Floats]

    @property
    def period_s(self) -> float:
        """Sample period in device seconds."""
        return 1 / (self.rate_hz * (1 + self.fast_ppm * 1e-6))


@dataclass(slots=True)
class Reading:
    """Samples of one sensor in the processor's buffer, until they are sent."""

    stamps_ms: list[int] = field(default_factory=list[int])  # Reading time of each sample.
    # Time of measurement of each sample, in device seconds.
    times_s: list[float] = field(default_factory=list[float])


class _Sampler:
    """The samples of one sensor since it was switched on."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self._next = 1

    def read(self, before_s: float, now_s: float, into: Reading) -> None:
        """Move samples into a buffer at each reading time of the processor.

        Parameters
        ----------
        before_s, now_s
            Device seconds; the processor reads several times between them.
        """
        first = ceil(before_s / READ_EVERY_S)
        for look in range(first, ceil(now_s / READ_EVERY_S)):
            self._read_at(look * READ_EVERY_S, into)

    def _read_at(self, look_s: float, into: Reading) -> None:
        while (at := self._next * self.part.period_s) <= look_s:
            into.times_s.append(at)
            into.stamps_ms.append(int(look_s * 1000))
            self._next += 1


def _conductance(wearer: Wearer, t: Floats) -> Floats:
    return wearer.skin_conductance_us(t)[:, np.newaxis]


def _pulse(wearer: Wearer, t: Floats) -> Floats:
    swing = _PULSE_SWING * wearer.pulse(t)[:, np.newaxis]
    return np.round(_PULSE_COUNTS - swing * np.array(_DEPTHS, np.float64))


def _temperature(wearer: Wearer, t: Floats) -> Floats:
    return wearer.skin_temperature_c(t)[:, np.newaxis]


def _acceleration(wearer: Wearer, t: Floats) -> Floats:
    return wearer.acceleration_g(t)


def _rotation(wearer: Wearer, t: Floats) -> Floats:
    axes = [2.0 * np.sin(2 * pi * 0.3 * t + k) + wearer.noise(t, 0.2, f"r{k}") for k in range(3)]
    return np.stack(axes, axis=1)


def _field(wearer: Wearer, t: Floats) -> Floats:
    axes = [level + wearer.noise(t, 0.4, f"m{level:g}") for level in (21.0, -4.0, -43.0)]
    return np.stack(axes, axis=1)


def _parts(ppg_hz: float, acc_hz: float) -> tuple[Part, ...]:
    """Return the sensors of an EmotiBit V5 whose pulse and acceleration have these rates."""
    return (
        Part("eda", ("EA",), 15.0, 0.0, _conductance),
        Part("ppg", ("PI", "PR", "PG"), ppg_hz, 900.0, _pulse),
        Part("st", ("T1",), 7.5, 0.0, _temperature),
        Part("acc", ("AX", "AY", "AZ"), acc_hz, -1200.0, _acceleration),
        Part("gyro", ("GX", "GY", "GZ"), 25.0, -1200.0, _rotation),
        Part("mag", ("MX", "MY", "MZ"), 25.0, -1200.0, _field),
    )


class Measured(NamedTuple):
    """Samples of one sensor, for the truth."""

    data_name: str
    times: list[float]
    values: list[list[float]]


class Round(NamedTuple):
    """Packets sent together; samples are assigned to packets by index in `packets`."""

    packets: list[bytes]
    samples: dict[int, Measured]


class Rounds:
    """The rounds of one EmotiBit since it was switched on.

    Parameters
    ----------
    oscillator
        Its processor's clock.
    worn_since_s
        LSL time at which the wearer's time is 0.
    ppg_hz, acc_hz
        Rates of pulse and acceleration by its firmware.
    """

    def __init__(
        self,
        oscillator: Oscillator,
        wearer: Wearer,
        worn_since_s: float,
        ppg_hz: float,
        acc_hz: float,
    ) -> None:
        self._oscillator = oscillator
        self._wearer = wearer
        self._worn_since_s = worn_since_s
        self._samplers = [_Sampler(part) for part in _parts(ppg_hz, acc_hz)]
        self._before_s = 0.0
        self._last_beat_s = worn_since_s
        self._count = 0
        self._number = 0
        self._kept: dict[str, list[list[str]]] = {}
        # Whether a channel of a sensor is sometimes read one sample later than the others.
        self.is_apart = False

    def next(self, now_s: float, battery_percent: float) -> Round:
        """Return the round that ends now, in device seconds, with consecutive packet numbers."""
        packets: list[bytes] = []
        samples: dict[int, Measured] = {}
        for sampler in self._samplers:
            reading = Reading()
            sampler.read(self._before_s, now_s, reading)
            if reading.times_s:
                measured, texts = self._measured(sampler.part, reading)
                packets += self._channels(sampler.part, reading, texts)
                samples[len(packets) - 1] = measured
        now_ms = int(now_s * 1000)
        beats = self._beats(now_s, samples, len(packets))
        packets += [self._packet(now_ms, *each) for each in beats]
        if self._count % BATTERY_EVERY_ROUNDS == 0:
            samples[len(packets)] = Measured(
                "bat", [self._oscillator.true_time(now_s)], [[battery_percent]]
            )
            packets.append(self._packet(now_ms, "B%", [f"{battery_percent:.0f}"]))
        if self._count % SYNC_EVERY_ROUNDS == SYNC_EVERY_ROUNDS - 1:
            packets.append(self._packet(now_ms, REQUEST, [TIME_LOCAL, TIME_UTC]))
        self._before_s = now_s
        self._count += 1
        return Round(packets, samples)

    def note(self, tag: str, payload: list[str]) -> bytes:
        """Return a packet with a host's message, as for the file on its memory card.

        It has the time of the last round, because a delayed virtual device may still have to send
        earlier rounds, unlike a real one.
        """
        return self._packet(int(self._before_s * 1000), tag, payload)

    def _channels(self, part: Part, reading: Reading, texts: list[list[str]]) -> Iterator[bytes]:
        """Yield a packet for each channel."""
        is_apart = self.is_apart and self._count % APART_EVERY_ROUNDS == 0
        kept = self._kept.pop(part.data_name, [[] for _ in part.tags])
        for place, (tag, new) in enumerate(zip(part.tags, texts, strict=True)):
            channel, stamp_ms = kept[place] + new, reading.stamps_ms[-1]
            if is_apart and place < len(part.tags) - 1 and len(new) > 1:
                # The last channel is read slightly later, when there is one more sample.
                left = self._kept.setdefault(part.data_name, [[] for _ in part.tags])
                left[place] = channel[-1:]
                channel, stamp_ms = channel[:-1], reading.stamps_ms[-2]
            # The timestamps of the pulse's channels differ slightly.
            late_ms = place // 2 if part.data_name == "ppg" else 0
            yield self._packet(stamp_ms + late_ms, tag, channel)

    def _measured(self, part: Part, reading: Reading) -> tuple[Measured, list[list[str]]]:
        times = [self._oscillator.true_time(each) for each in reading.times_s]
        since = np.array(times, np.float64) - self._worn_since_s
        values = part.measure(self._wearer, since)
        digits = _DIGITS[part.data_name]
        texts = [[f"{value:.{digits}f}" for value in channel] for channel in values.T]
        sent = [[float(text) for text in row] for row in zip(*texts, strict=True)]
        return Measured(part.data_name, times, sent), texts

    def _beats(
        self, now_s: float, samples: dict[int, Measured], at: int
    ) -> Iterator[tuple[str, list[str]]]:
        """Yield heart rate and interval at each beat that the firmware has detected."""
        now = self._oscillator.true_time(now_s) - self._worn_since_s
        beats = self._wearer.beats_between(self._last_beat_s - self._worn_since_s, now)
        self._last_beat_s = now + self._worn_since_s
        for beat in beats[-1:]:
            interval_s = float(self._wearer.rr_before(np.array([beat], np.float64))[0])
            told = (
                ("ibi", "BI", f"{1000 * interval_s:.1f}", 1e-3),
                ("hr", "HR", f"{60 / interval_s:.0f}", 1.0),
            )
            for place, (data_name, tag, text, unit) in enumerate(told, at):
                times = [now + self._worn_since_s]
                samples[place] = Measured(data_name, times, [[float(text) * unit]])
                yield tag, [text]

    def _packet(self, time_ms: int, tag: str, payload: list[str]) -> bytes:
        self._number += 1
        return packet(time_ms, self._number - 1, tag, payload)


def _read_apart(rounds: Rounds) -> None:
    rounds.is_apart = True


def _read_together(rounds: Rounds) -> None:
    rounds.is_apart = False


ROUNDS_EFFECTS: Effects[Rounds] = MappingProxyType(
    {Untidiness.APART: lasting(_read_apart, _read_together)}
)


class Message(NamedTuple):
    """A packet of a host."""

    tag: str
    payload: tuple[str, ...]

    def behind(self, label: str) -> int | None:
        """Return the number after a label in the payload."""
        if label not in self.payload[:-1]:
            return None
        return int(self.payload[self.payload.index(label) + 1])


def packet(time_ms: int, number: int, tag: str, payload: Sequence[str], version: int = 1) -> bytes:
    """Return a packet with its line feed."""
    header = f"{time_ms},{number % 65536},{len(payload)},{tag},{version},100"
    return ",".join([header, *payload]).encode("ascii") + b"\n"


def heard(line: bytes) -> Message:
    """Parse a host's packet without its line feed."""
    fields = line.decode("ascii").strip().split(",")
    return Message(fields[3], tuple(fields[6:]))


def datagrams(packets: Sequence[bytes]) -> list[list[bytes]]:
    """Group packets into datagrams of limited size."""
    packed: list[list[bytes]] = [[]]
    for each in packets:
        if packed[-1] and sum(map(len, packed[-1])) + len(each) > LONGEST_DATAGRAM:
            packed.append([])
        packed[-1].append(each)
    return [each for each in packed if each]


class _Answers(asyncio.DatagramProtocol):
    """Receives a host's packets on the data channel."""

    def __init__(self, obey: Callable[[Message], None]) -> None:
        self._obey = obey

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Process one packet per datagram, like the firmware."""
        self._obey(heard(data.split(b"\n")[0]))

    def error_received(self, exc: Exception) -> None:
        """Ignore that a host is gone."""


class Host(asyncio.Protocol):
    """One connection to a host.

    Parameters
    ----------
    here
        Address of the device.
    host, control_port, data_port
        Address and ports of the host.
    obey
        Called with each packet that it sends on either channel.
    lost
        Called when it ends the connection.
    """

    def __init__(
        self,
        here: str,
        host: str,
        control_port: int,
        data_port: int,
        obey: Callable[[Message], None],
        lost: Callable[[], None],
    ) -> None:
        self._here = here
        self._host = host
        self._control_port = control_port
        self.data_port = data_port  # Identifies the same host.
        self.pinged_s = 0.0  # Time of its last ping.
        self._obey = obey
        self._lost = lost
        self._control: asyncio.Transport | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._rest = b""
        self._data: asyncio.DatagramTransport | None = None

    def connect(self, done: Callable[[], None]) -> None:
        """Connect the control channel, without which no data are sent, and call *done*."""

        async def connect() -> None:
            loop = asyncio.get_running_loop()
            with suppress(OSError):
                self._data, _ = await loop.create_datagram_endpoint(
                    lambda: _Answers(self._obey), (self._here, 0)
                )
                await loop.create_connection(
                    lambda: self, self._host, self._control_port, local_addr=(self._here, 0)
                )
                done()
                return
            self._lost()

        self._connecting = asyncio.create_task(connect())

    def send(self, datagram: bytes) -> bool:
        """Send data; return False without a connection."""
        if self._control is None or self._data is None:
            return False
        self._data.sendto(datagram, (self._host, self.data_port))
        return True

    def close(self) -> None:
        """Close the connection to the host."""
        if self._connecting is not None:
            self._connecting.cancel()
        if self._control is not None:
            break_off(self._control)
            self._control = None
        if self._data is not None:
            self._data.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set up the control channel."""
        assert isinstance(transport, asyncio.Transport)
        self._control = transport

    def data_received(self, data: bytes) -> None:
        """Execute complete packets."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._obey(heard(line))

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the host has ended it."""
        if self._control is not None:
            self._control = None
            self._lost()
