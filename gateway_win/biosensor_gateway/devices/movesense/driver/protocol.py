"""GATT SensorData Protocol: commands out, messages and their payloads in; no I/O and no clock.

A command is ``command | reference | argument``, a message ``kind | reference | payload``, all
little-endian; the reference, chosen by the host, ties them together [1]_. The first version
answers ``HELLO`` with that word and subscriptions not at all [2]_, later ones name
themselves and answer with a status as of HTTP [3]_.

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

# Arrays have no length of their own, they fill the payload. Where there are several, they are
# equally long and stand one behind the other, not interleaved. The layouts are those that
# Movesense's example programs read (samples/gatt_sensordata_app, Python and iOS clients). What the
# documentation calls millivolts are whole microvolts: samples that came on both paths at a time had
# the ratio 0.38147.
STAMP_BYTES = 4
VECTOR_BYTES = 12
ECG_SAMPLES = 16
"""Of a packet, at all rates."""
MICROVOLTS_PER_COUNT = 0.381469726563
_ABSOLUTE_ZERO_C = -273.15
_FASTEST_BPM, _HOTTEST_K = 500.0, 1000.0
_ECG_TYPES = {4: np.dtype("<i4"), 2: np.dtype("<i2")}
_MICROVOLTS = {4: MICROVOLTS_PER_COUNT, 2: 1.0}

Floats = NDArray[np.float64]


class Block(NamedTuple):
    """Samples of one packet.

    Attributes
    ----------
    stamp_ms
        Device clock at the first one, in ms since it was switched on, modulo 2**32.
    samples : array, shape (n_streams, n_samples, n_channels)
        Of each stream that shares the packet.
    """

    stamp_ms: int
    samples: Floats


class HeartRate(NamedTuple):
    """Mean heart rate [1/min], 0 if there is none, and R-R intervals [ms], oldest first."""

    bpm: float
    intervals_ms: tuple[int, ...]


def parse_ecg(payload: bytes, width: int) -> Block | None:
    """Read a packet of ECG [uV]; None if it is cut short.

    Parameters
    ----------
    width
        Bytes a sample: 4 for counts, 2 for microvolts. A packet that has as many samples as it
        always has tells its width by itself.
    """
    body = payload[STAMP_BYTES:]
    width = len(body) // ECG_SAMPLES if len(body) in (2 * ECG_SAMPLES, 4 * ECG_SAMPLES) else width
    if not body or len(body) % width:
        return None
    counts = np.frombuffer(body, _ECG_TYPES[width])
    microvolts = counts.astype(np.float64) * _MICROVOLTS[width]
    return Block(_stamp(payload), microvolts.reshape(1, -1, 1))


def parse_vectors(payload: bytes, streams: int) -> Block | None:
    """Read a packet of vectors of so many streams; None if it is cut short or has no numbers."""
    body = payload[STAMP_BYTES:]
    if not body or len(body) % (VECTOR_BYTES * streams):
        return None
    numbers = np.frombuffer(body, "<f4")
    # Some that are no numbers cannot even be turned into float64 without a warning.
    if not np.isfinite(numbers).all():
        return None
    return Block(_stamp(payload), numbers.astype(np.float64).reshape(streams, -1, 3))


def parse_heart_rate(payload: bytes) -> HeartRate | None:
    """Read a heart rate; None if it is cut short or makes no sense. It has no stamp."""
    if len(payload) < 4 or len(payload) % 2:
        return None
    (bpm,) = np.frombuffer(payload[:4], "<f4").tolist()
    intervals = np.frombuffer(payload[4:], "<u2").tolist()
    return HeartRate(bpm, tuple(intervals)) if 0 <= bpm <= _FASTEST_BPM else None


def parse_temperature(payload: bytes) -> tuple[int, float] | None:
    """Read a temperature: its stamp [ms], and degrees Celsius; None if it makes no sense."""
    if len(payload) != STAMP_BYTES + 4:
        return None
    (kelvin,) = np.frombuffer(payload[STAMP_BYTES:], "<f4").tolist()
    return (_stamp(payload), kelvin + _ABSOLUTE_ZERO_C) if 0 < kelvin < _HOTTEST_K else None


def in_g(metres_per_second_squared: Floats) -> Floats:
    """Turn accelerations as the device sends them into g."""
    return metres_per_second_squared / STANDARD_GRAVITY


def _stamp(payload: bytes) -> int:
    return int.from_bytes(payload[:STAMP_BYTES], "little")


class Command(IntEnum):
    """First byte of a command."""

    HELLO = 0
    SUBSCRIBE = 1
    UNSUBSCRIBE = 2


class Kind(IntEnum):
    """First byte of a message; data that do not fit into one message go on in the next."""

    ANSWER = 1
    DATA = 2
    DATA_PART_2 = 3
    DATA_PART_3 = 4


class Message(NamedTuple):
    """What the device sends.

    Attributes
    ----------
    reference
        Of the command that it answers, or that asked for the data.
    """

    kind: Kind
    reference: int
    payload: bytes

    @property
    def status(self) -> int:
        """Status of an answer, as of HTTP; 0 if it has none."""
        status = int.from_bytes(self.payload[:2], "little")
        # The first version has the bytes of its only one the other way round.
        return status if status <= _LAST_STATUS else int.from_bytes(self.payload[:2], "big")

    @property
    def is_refusal(self) -> bool:
        """Whether it answers that the command was not carried out."""
        return self.kind is Kind.ANSWER and self.status >= FIRST_ERROR


class Greeting(NamedTuple):
    """What a device says of itself.

    Attributes
    ----------
    answers
        Whether it answers subscriptions.
    serial_number, product, app, app_version
        Empty where it does not tell.
    """

    answers: bool
    serial_number: str = ""
    product: str = ""
    app: str = ""
    app_version: str = ""


_KINDS = frozenset(Kind)


def parse_message(data: bytes) -> Message | None:
    """Read a notification; None if it is none of this protocol."""
    if len(data) < 2 or data[0] not in _KINDS:
        return None
    return Message(Kind(data[0]), data[1], data[2:])


def parse_greeting(payload: bytes) -> Greeting:
    """Read the answer to ``HELLO``, the one answer that has no status.

    A byte with the version, then texts that end with a zero byte: serial number, product,
    address, name and version of the app that runs on the device.
    """
    if payload == _GREETING:
        return Greeting(answers=False)
    texts = [each.decode("utf-8", "ignore").strip() for each in payload[1:].split(b"\0")]
    serial, product, _address, app, version, *_ = *texts, "", "", "", "", ""
    return Greeting(True, *map(_printable, (serial, product, app, version)))


def is_refused_greeting(payload: bytes) -> bool:
    """Whether the answer to ``HELLO`` is a status after all."""
    return len(payload) == 2 and int.from_bytes(payload, "little") >= FIRST_ERROR


def hello(reference: int) -> bytes:
    """Command that asks the device what it is."""
    return bytes([Command.HELLO, reference])


def subscribe(reference: int, path: str) -> bytes:
    """Command that has the device send a measurement, named by its path."""
    return bytes([Command.SUBSCRIBE, reference]) + path.encode("ascii")


def unsubscribe(reference: int) -> bytes:
    """Command that ends that."""
    return bytes([Command.UNSUBSCRIBE, reference])


def _printable(text: str) -> str:
    return "".join(character for character in text if character.isprintable())


class Packet(NamedTuple):
    """A complete payload and the LSL time at which its last part arrived."""

    payload: bytes
    arrival_s: float


# Nothing in a part says whether another one follows. A packet is complete when it is as long as
# those of its measurement are; if none ever is, what comes before the next first part is.
class Assembler:
    """Packets of one subscription.

    Parameters
    ----------
    full_bytes
        How long its packets are likely to be; 0 if each is complete as it comes.
    sample_bytes
        Their samples, of all streams together.

    Attributes
    ----------
    dropped_bytes
        Of parts that make no packet.
    """

    def __init__(self, full_bytes: int, sample_bytes: int) -> None:
        self.dropped_bytes = 0
        self._full_bytes = full_bytes
        self._sample_bytes = sample_bytes
        self._is_certain = False
        self._held: Packet | None = None

    def take(self, part: Message, arrival_s: float) -> list[Packet]:
        """Return the packets that are complete now, at most two; usually one.

        Parameters
        ----------
        part
            A message of data.
        arrival_s
            LSL clock when it arrived.
        """
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
        """Return what is held if it may be a packet of another length than was likely."""
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
"""The others are those of the measurements; none is 0."""
_ECG, _MOVEMENT, _HEART_RATE, _TEMPERATURE = 100, 99, 98, 97
_PACKETS_PER_SECOND = 13
"""Of movement, at all rates: 4 samples a packet at 52 Hz, 8 at 104 Hz."""
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
    """One subscription; a device has room for four.

    Attributes
    ----------
    reference
        Which the device sends with its packets.
    streams
        Data names, in the order of the arrays in a packet.
    rate_hz
        Nominal; None where packets come when there is something.
    full_bytes
        How long a packet is likely to be; 0 where each is complete as it comes.
    sample_bytes
        Of all streams together.
    """

    reference: int
    path: str
    streams: tuple[str, ...]
    rate_hz: int | None = None
    full_bytes: int = 0
    sample_bytes: int = 1


HEART_RATE = Measurement(_HEART_RATE, "/Meas/HR", ("hr", "ibi"))
TEMPERATURE = Measurement(_TEMPERATURE, "/Meas/Temp", ("temp",))


def ecg(rate_hz: int, *, in_millivolts: bool) -> Measurement:
    """Return the measurement of the ECG, as counts or in what the device calls millivolts."""
    width = 2 if in_millivolts else 4
    path = f"/Meas/ECG/{rate_hz}" + ("/mV" if in_millivolts else "")
    full = STAMP_BYTES + width * ECG_SAMPLES
    return Measurement(_ECG, path, ("ecg",), rate_hz, full, width)


def movement(wanted: Collection[str], rate_hz: int) -> Measurement:
    """Return the measurement that has the wanted streams, all of them stamped together.

    Parameters
    ----------
    wanted
        Some of `MOVEMENT`.
    """
    path, streams = _SHARED.get(frozenset(wanted), _ALL)
    sample = VECTOR_BYTES * len(streams)
    full = STAMP_BYTES + rate_hz // _PACKETS_PER_SECOND * sample
    return Measurement(_MOVEMENT, f"{path}/{rate_hz}", streams, rate_hz, full, sample)
