"""GATT SensorData Protocol: commands out, messages in; no I/O and no clock.

A command is ``command | reference | argument``, a message ``kind | reference | payload``, all
little-endian; the reference, chosen by the host, ties them together [1]_. The first version
answers ``HELLO`` with that word and subscriptions not at all [2]_, later ones name
themselves and answer with a status as of HTTP [3]_.

.. [1] https://www.movesense.com/docs/esw/gatt_sensordata_protocol
.. [2] Movesense device library, samples/gatt_sensordata_app.
.. [3] The same, since its version 2.3.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

SERVICE = "34802252-7185-4d5d-b431-630e7050e8f0"
COMMAND = "34800001-7185-4d5d-b431-630e7050e8f0"
DATA = "34800002-7185-4d5d-b431-630e7050e8f0"

FIRST_ERROR = 400
TOO_MANY_REQUESTS = 429
OUT_OF_SLOTS = 507
_LAST_STATUS = 599
_GREETING = b"Hello"


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
    kind
    reference
        Of the command that it answers, or that asked for the data.
    payload
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
