"""GATT SensorData Protocol: commands out, messages and their payloads in; no I/O and no clock.

A command is ``command | reference | argument``, a message ``kind | reference | payload``, all
little-endian; the reference is chosen by the host and links them [1]_. The first version answers
``HELLO`` with that word and does not answer subscriptions [2]_; later ones identify themselves and
answer with an HTTP-like status [3]_.

.. [1] https://www.movesense.com/docs/esw/gatt_sensordata_protocol
.. [2] Movesense device library, samples/gatt_sensordata_app.
.. [3] The same, since its version 2.3.
"""

from __future__ import annotations

from collections.abc import Collection
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import STANDARD_GRAVITY

SERVICE = "34802252-7185-4d5d-b431-630e7050e8f0"
COMMAND = "34800001-7185-4d5d-b431-630e7050e8f0"
DATA = "34800002-7185-4d5d-b431-630e7050e8f0"

FIRST_ERROR = 400
TOO_MANY_REQUESTS = 429
OUT_OF_SLOTS = 507
_LAST_STATUS = 599
_GREETING = b"Hello"

# Arrays have no length field; they fill the payload. Several arrays have equal length and follow
# each other, not interleaved. The layouts are those in Movesense's example programs
# (samples/gatt_sensordata_app, Python and iOS clients). What the documentation calls millivolts
# are whole microvolts: samples received on both paths at once had the ratio 0.38147.
STAMP_BYTES = 4
VECTOR_BYTES = 12
ECG_SAMPLES = 16
"""Samples per packet, at all rates."""
MICROVOLTS_PER_COUNT = 0.381469726563
_ABSOLUTE_ZERO_C = -273.15
_FASTEST_BPM, _HOTTEST_K = 500.0, 1000.0
_ECG_TYPES = {4: np.dtype("<i4"), 2: np.dtype("<i2")}
_MICROVOLTS = {4: MICROVOLTS_PER_COUNT, 2: 1.0}

Floats = NDArray[np.float64]


class Block(NamedTuple):
    """Samples of one packet."""

    stamp_ms: int  # Device time of the first sample, in ms since power-on, modulo 2**32.
    samples: Floats


class HeartRate(NamedTuple):
    """Mean heart rate [1/min], 0 if none, and R-R intervals [ms], oldest first."""

    bpm: float
    intervals_ms: tuple[int, ...]


def parse_ecg(payload: bytes, width: int) -> Block | None:
    """Parse an ECG packet [uV]; None if it is truncated.

    Parameters
    ----------
    width
        Bytes per sample: 4 for counts, 2 for microvolts. Only used if the packet does not have the
        usual number of samples, which shows the width.
    """
    body = payload[STAMP_BYTES:]
    width = len(body) // ECG_SAMPLES if len(body) in (2 * ECG_SAMPLES, 4 * ECG_SAMPLES) else width
    if not body or len(body) % width:
        return None
    counts = np.frombuffer(body, _ECG_TYPES[width])
    microvolts = counts.astype(np.float64) * _MICROVOLTS[width]
    return Block(_stamp(payload), microvolts.reshape(1, -1, 1))


def parse_vectors(payload: bytes, streams: int) -> Block | None:
    """Parse a packet of vectors of several streams; None if truncated or not finite."""
    body = payload[STAMP_BYTES:]
    if not body or len(body) % (VECTOR_BYTES * streams):
        return None
    numbers = np.frombuffer(body, "<f4")
    # Converting some NaN bit patterns to float64 causes a warning, so this is checked first.
    if not np.isfinite(numbers).all():
        return None
    return Block(_stamp(payload), numbers.astype(np.float64).reshape(streams, -1, 3))


def parse_heart_rate(payload: bytes) -> HeartRate | None:
    """Parse a heart rate, which has no timestamp; None if truncated or invalid."""
    if len(payload) < 4 or len(payload) % 2:
        return None
    (bpm,) = np.frombuffer(payload[:4], "<f4").tolist()
    intervals = np.frombuffer(payload[4:], "<u2").tolist()
    return HeartRate(bpm, tuple(intervals)) if 0 <= bpm <= _FASTEST_BPM else None


def parse_temperature(payload: bytes) -> tuple[int, float] | None:
    """Parse a temperature: timestamp [ms] and degrees Celsius; None if invalid."""
    if len(payload) != STAMP_BYTES + 4:
        return None
    (kelvin,) = np.frombuffer(payload[STAMP_BYTES:], "<f4").tolist()
    return (_stamp(payload), kelvin + _ABSOLUTE_ZERO_C) if 0 < kelvin < _HOTTEST_K else None


def in_g(metres_per_second_squared: Floats) -> Floats:
    """Convert accelerations from the device's unit to g."""
    return metres_per_second_squared / STANDARD_GRAVITY


def _stamp(payload: bytes) -> int:
    return int.from_bytes(payload[:STAMP_BYTES], "little")


class Command(IntEnum):
    """First byte of a command."""

    HELLO = 0
    SUBSCRIBE = 1
    UNSUBSCRIBE = 2


class Kind(IntEnum):
    """First byte of a message; data that do not fit into one message continue in the next."""

    ANSWER = 1
    DATA = 2
    DATA_PART_2 = 3
    DATA_PART_3 = 4


class Message(NamedTuple):
    """A message from the device."""

    kind: Kind
    reference: int  # Reference of the command that it answers or that requested the data.
    payload: bytes

    @property
    def status(self) -> int:
        """HTTP-like status of an answer; 0 if it has none."""
        status = int.from_bytes(self.payload[:2], "little")
        # The first version's only status has its bytes swapped.
        return status if status <= _LAST_STATUS else int.from_bytes(self.payload[:2], "big")

    @property
    def is_refusal(self) -> bool:
        """Whether it reports that the command failed."""
        return self.kind is Kind.ANSWER and self.status >= FIRST_ERROR


class Greeting(NamedTuple):
    """The device information."""

    answers: bool
    # serial_number, product, app, app_version: empty if not reported.
    serial_number: str = ""
    product: str = ""
    app: str = ""
    app_version: str = ""


_KINDS = frozenset(Kind)


def parse_message(data: bytes) -> Message | None:
    """Parse a notification; None if it does not belong to this protocol."""
    if len(data) < 2 or data[0] not in _KINDS:
        return None
    return Message(Kind(data[0]), data[1], data[2:])


def parse_greeting(payload: bytes) -> Greeting:
    """Parse the answer to ``HELLO``, the only answer without a status.

    It consists of a version byte, then zero-terminated texts: serial number, product, address,
    name and version of the app on the device.
    """
    if payload == _GREETING:
        return Greeting(answers=False)
    texts = [each.decode("utf-8", "ignore").strip() for each in payload[1:].split(b"\0")]
    serial, product, _address, app, version, *_ = *texts, "", "", "", "", ""
    return Greeting(True, *map(_printable, (serial, product, app, version)))


def is_refused_greeting(payload: bytes) -> bool:
    """Whether the answer to ``HELLO`` is an error status."""
    return len(payload) == 2 and int.from_bytes(payload, "little") >= FIRST_ERROR


def hello(reference: int) -> bytes:
    """Return the command that requests the device information."""
    return bytes([Command.HELLO, reference])


def subscribe(reference: int, path: str) -> bytes:
    """Return the command that subscribes to a measurement, given its path."""
    return bytes([Command.SUBSCRIBE, reference]) + path.encode("ascii")


def unsubscribe(reference: int) -> bytes:
    """Return the command that ends a subscription."""
    return bytes([Command.UNSUBSCRIBE, reference])


def _printable(text: str) -> str:
    return "".join(character for character in text if character.isprintable())


class Packet(NamedTuple):
    """A complete payload and the LSL time at which its last part arrived."""

    payload: bytes
    arrival_s: float


# Parts do not indicate whether another one follows. A packet is complete when it has the usual
# length of its measurement, or else when the next packet starts.
class Assembler:
    """Assembles the packets of one subscription.

    Parameters
    ----------
    full_bytes
        Usual length of its packets; 0 if each part is a complete packet.
    sample_bytes
        Size of one sample of all streams together.
    """

    def __init__(self, full_bytes: int, sample_bytes: int) -> None:
        self.dropped_bytes = 0  # Bytes of parts without a complete packet.
        self._full_bytes = full_bytes
        self._sample_bytes = sample_bytes
        self._is_certain = False
        self._held: Packet | None = None

    def take(self, part: Message, arrival_s: float) -> list[Packet]:
        """Add a part; return the packets that are complete now, at most two."""
        if not self._full_bytes:
            return [Packet(part.payload, arrival_s)]
        complete: list[Packet] = []
        if part.kind is Kind.DATA:
            complete += self._give_up()
            self._held = Packet(part.payload, arrival_s)
        elif self._held is None:
            self.dropped_bytes += len(part.payload)
        else:
            self._held = Packet(self._held.payload + part.payload, arrival_s)
        if self._held is not None and len(self._held.payload) == self._full_bytes:
            self._is_certain = True
            complete.append(self._held)
            self._held = None
        return complete

    def _give_up(self) -> list[Packet]:
        """Return the buffered parts if they may be a packet of unusual length."""
        held, self._held = self._held, None
        if held is None:
            return []
        length = len(held.payload)
        if self._is_certain or (length - STAMP_BYTES) % self._sample_bytes:
            self.dropped_bytes += length
            return []
        self._full_bytes, self._is_certain = length, True
        return [held]


HELLO_REFERENCE = 1
"""The measurements use other references; none is 0."""
_ECG, _MOVEMENT, _HEART_RATE, _TEMPERATURE = 100, 99, 98, 97
# Packets per second of movement data at all rates: 4 samples at 52 Hz, 8 at 104 Hz.
_PACKETS_PER_SECOND = 13
_SHARED = {
    frozenset({"acc"}): ("/Meas/Acc", ("acc",)),
    frozenset({"gyro"}): ("/Meas/Gyro", ("gyro",)),
    frozenset({"mag"}): ("/Meas/Magn", ("mag",)),
    frozenset({"acc", "gyro"}): ("/Meas/IMU6", ("acc", "gyro")),
    frozenset({"acc", "mag"}): ("/Meas/IMU6m", ("acc", "mag")),
}
_ALL = ("/Meas/IMU9", ("acc", "gyro", "mag"))
MOVEMENT = _ALL[1]
"""Data names of the streams that come from the movement sensor."""


class Measurement(NamedTuple):
    """One subscription; a device has room for four."""

    reference: int  # Sent by the device with each packet.
    path: str
    streams: tuple[str, ...]  # Data names, in the order of the arrays in a packet.
    rate_hz: int | None = None  # Nominal rate; None for irregular packets.
    full_bytes: int = 0  # Usual length of a packet; 0 if each part is a complete packet.
    sample_bytes: int = 1  # Size of one sample of all streams together.


HEART_RATE = Measurement(_HEART_RATE, "/Meas/HR", ("hr", "ibi"))
TEMPERATURE = Measurement(_TEMPERATURE, "/Meas/Temp", ("temp",))


def ecg(rate_hz: int, *, in_millivolts: bool) -> Measurement:
    """Return the ECG measurement, in counts or in what the device calls millivolts."""
    width = 2 if in_millivolts else 4
    path = f"/Meas/ECG/{rate_hz}" + ("/mV" if in_millivolts else "")
    full = STAMP_BYTES + width * ECG_SAMPLES
    return Measurement(_ECG, path, ("ecg",), rate_hz, full, width)


def movement(wanted: Collection[str], rate_hz: int) -> Measurement:
    """Return the measurement that contains the wanted streams, with common timestamps.

    Parameters
    ----------
    wanted
        Some of `MOVEMENT`.
    """
    path, streams = _SHARED.get(frozenset(wanted), _ALL)
    sample = VECTOR_BYTES * len(streams)
    full = STAMP_BYTES + rate_hz // _PACKETS_PER_SECOND * sample
    return Measurement(_MOVEMENT, f"{path}/{rate_hz}", streams, rate_hz, full, sample)
