"""Decodes a Shimmer's bytes to messages; no I/O and no clock.

Every message from the device begins with a byte for its kind::

    FF          a command was carried out (ACK)
    FF rsp ...  ... and this is the answer
    FE          a command was refused (NACK)
    00 ...      data packet, while streaming
    8A ...      status or battery, asked for or not, also while streaming

With checksums (see `checksum`), each message ends with one. Older firmware sends an ACK before an
unrequested status, which acknowledges nothing: ``FF 8A 71`` is never a bare ACK.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.messages import (
    IN_STREAM,
    Ack,
    CrcMode,
    Message,
    Nack,
    Packet,
    ReplyForm,
    Stamped,
    checksum,
    decode_reply,
    reply_size,
)

TICK_MODULUS = 1 << 24
MAX_STEP_TICKS = 1 << 16
"""Two seconds: a packet further ahead is only accepted together with its successor."""

_DATA, _NACK, _ACK = 0x00, 0xFE, 0xFF
_HEADS = frozenset({_DATA, _NACK, _ACK, IN_STREAM})
_STAMP_SIZE = 4
_SLICE = 4096


class ShimmerProtocol:
    """Incremental decoder of one connection's bytes.

    ``feed`` never raises, whatever the bytes; unusable bytes are counted. Without full checksums,
    a data packet is only accepted if its timestamp is a whole number of periods after the previous
    one; without any checksum, another message must also seem to follow.
    """

    def __init__(self) -> None:
        self.crc = CrcMode.OFF  # Current checksum mode of the device.
        self.form = ReplyForm()  # Formats that depend on the kind of device.
        self.dropped_bytes = 0  # Number of bytes outside of valid messages.
        self._layout: Layout | None = None
        self._divisor = 1
        self._buffer = bytearray()
        self._consumed = 0
        self._arrivals: deque[tuple[int, float]] = deque()
        self._newest_ticks: int | None = None
        self._settled = False

    @property
    def buffered(self) -> int:
        """Number of bytes held back as a possible start of a message."""
        return len(self._buffer)

    @property
    def undecided(self) -> bool:
        """Whether `settle` might find a message in the buffer."""
        return bool(self._buffer) and not self._settled

    def expect_data(self, layout: Layout, divisor: int) -> None:
        """Accept data packets from now on; call this before streaming is started.

        Parameters
        ----------
        divisor
            Ticks between two packets.
        """
        self._layout, self._divisor = layout, divisor
        self._newest_ticks = None
        # Without checksums, two damaged bytes could look like a long calibration and hide packets.
        self.form = replace(self.form, calibration_blocks=0)

    def feed(self, data: bytes, arrival_s: float) -> list[Stamped]:
        """Add bytes in pieces of any size; return the messages that they complete.

        Parameters
        ----------
        arrival_s
            LSL time of arrival; returned with the messages that end in these bytes.
        """
        found: list[Stamped] = []
        self._settled = False
        for start in range(0, len(data), _SLICE):
            self._buffer += data[start : start + _SLICE]
            self._arrivals.append((self._consumed + len(self._buffer), arrival_s))
            self._scan(found)
        return found

    def settle(self) -> list[Stamped]:
        """After a pause, take a possible start of a longer message as complete."""
        found: list[Stamped] = []
        self._settled = True
        self._scan(found)
        return found

    def give_up(self) -> list[Stamped]:
        """Stop waiting for the rest of a message; return messages found after its first byte."""
        found: list[Stamped] = []
        while self._buffer:
            self._drop(1)
            self._scan(found)
        return found

    def _scan(self, found: list[Stamped]) -> None:
        start, end = 0, len(self._buffer)
        while start < end:
            size = self._message_size(start)
            if size is None:
                break
            if size == 0:
                self.dropped_bytes += 1
                start += 1
                continue
            arrival_s = self._arrival_of(self._consumed + start + size)
            found.append(Stamped(self._decode(start, size - self.crc), arrival_s))
            start += size
        self._remove(start)

    def _drop(self, count: int) -> None:
        self.dropped_bytes += count
        self._remove(count)

    def _remove(self, count: int) -> None:
        del self._buffer[:count]
        self._consumed += count
        while self._arrivals and self._arrivals[0][0] <= self._consumed:
            self._arrivals.popleft()

    def _arrival_of(self, end: int) -> float:
        return next(arrival_s for until, arrival_s in self._arrivals if until >= end)

    def _message_size(self, start: int) -> int | None:
        """Return the size of the message at *start*: 0 if there is none, None if incomplete."""
        body = self._body_size(start)
        if not body:
            return body
        end = start + body + self.crc
        if end > len(self._buffer):
            return None
        message = bytes(self._buffer[start : start + body])
        if checksum(message, self.crc) != bytes(self._buffer[start + body : end]):
            return 0
        believed = self._is_believed(message, end) if message[0] == _DATA else True
        return None if believed is None else (end - start) * believed

    def _body_size(self, start: int) -> int | None:
        head = self._buffer[start]
        if head == _DATA:
            return _STAMP_SIZE + self._layout.size if self._layout is not None else 0
        if head == _ACK:
            return self._ack_size(start)
        if head == IN_STREAM:
            return reply_size(self._buffer, start, self.form)
        return 1 if head == _NACK else 0

    def _ack_size(self, start: int) -> int | None:
        if start + 1 == len(self._buffer):
            return 1 if self._settled and self.crc is CrcMode.OFF else None
        answer = reply_size(self._buffer, start + 1, self.form)
        return None if answer is None else 1 + answer

    def _is_believed(self, packet: bytes, end: int) -> bool | None:
        """Whether a data packet is valid; None if that depends on the following bytes."""
        if self.crc is CrcMode.FULL:
            return True
        ticks = _ticks(packet)
        if self._newest_ticks is None or not self._follows(self._newest_ticks, ticks):
            return self._is_followed(ticks, end)
        if self.crc is CrcMode.LOW_BYTE:
            return True
        if end == len(self._buffer):
            return True if self._settled else None
        return self._buffer[end] in _HEADS

    def _is_followed(self, ticks: int, end: int) -> bool | None:
        """Whether the next packet's timestamp follows this one; None if incomplete."""
        behind = self._buffer[end : end + _STAMP_SIZE]
        if behind and behind[0] != _DATA:
            return False
        return self._follows(ticks, _ticks(behind)) if len(behind) == _STAMP_SIZE else None

    def _follows(self, ticks: int, later: int) -> bool:
        step = (later - ticks) % TICK_MODULUS
        periods = round(step / self._divisor)
        is_whole = abs(step - periods * self._divisor) <= self._divisor / 8
        return periods >= 1 and is_whole and step <= MAX_STEP_TICKS

    def _decode(self, start: int, size: int) -> Message:
        message = bytes(self._buffer[start : start + size])
        if message[0] == _DATA:
            assert self._layout is not None
            self._newest_ticks = _ticks(message)
            return Packet(self._newest_ticks, self._layout.read(message[_STAMP_SIZE:]))
        if message[0] == _NACK:
            return Nack()
        if message[0] == _ACK:
            return decode_reply(message[1:], self.form) if size > 1 else Ack()
        return decode_reply(message, self.form)


def _ticks(packet: bytes | bytearray) -> int:
    return int.from_bytes(packet[1:_STAMP_SIZE], "little")
