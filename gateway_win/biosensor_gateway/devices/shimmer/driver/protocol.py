"""Bytes of a Shimmer in, messages out; no I/O and no clock.

Every message from the device begins with a byte that tells its kind::

    FF          a command was carried out (ACK)
    FF rsp ...  ... and this is the answer
    FE          a command was refused (NACK)
    00 ...      data packet, while streaming
    8A ...      status or battery, asked for or not, also while streaming

With checksums (see `checksum`), each of them ends in one. Before an unasked status older
firmware puts an ACK, which acknowledges nothing: ``FF 8A 71`` is never a bare ACK.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.commands import CrcMode, checksum
from biosensor_gateway.devices.shimmer.driver.messages import (
    IN_STREAM,
    Ack,
    Message,
    Nack,
    Packet,
    ReplyForm,
    Stamped,
    decode_reply,
    reply_size,
)

TICK_MODULUS = 1 << 24
MAX_STEP_TICKS = 1 << 16
"""Two seconds: a packet that is further ahead is believed only with its successor."""

_DATA, _NACK, _ACK = 0x00, 0xFE, 0xFF
_HEADS = frozenset({_DATA, _NACK, _ACK, IN_STREAM})
_STAMP_SIZE = 4
_SLICE = 4096


class ShimmerProtocol:
    """Incremental decoder of one connection's bytes.

    ``feed`` never raises, whatever the bytes; what it cannot use is counted. Without
    full checksums a data packet is believed only if its timestamp follows the one
    before by a number of periods, and without any also if another message seems to
    begin behind it.

    Attributes
    ----------
    crc
        Checksum that the device appends now.
    form
        Sizes that depend on the kind of device.
    dropped_bytes
        Bytes that belonged to no valid message.
    """

    def __init__(self) -> None:
        self.crc = CrcMode.OFF
        self.form = ReplyForm()
        self.dropped_bytes = 0
        self._layout: Layout | None = None
        self._divisor = 1
        self._buffer = bytearray()
        self._consumed = 0
        self._arrivals: deque[tuple[int, float]] = deque()
        self._newest_ticks: int | None = None
        self._settled = False

    @property
    def buffered(self) -> int:
        """Bytes held back as the possible start of a message."""
        return len(self._buffer)

    @property
    def undecided(self) -> bool:
        """Whether `settle` might make a message of what is buffered."""
        return bool(self._buffer) and not self._settled

    def expect_data(self, layout: Layout, divisor: int) -> None:
        """Take data packets from now on; call it before streaming is started.

        Parameters
        ----------
        layout
            Of a packet.
        divisor
            Ticks between two packets.
        """
        self._layout, self._divisor = layout, divisor
        self._newest_ticks = None
        # Without checksums, two damaged bytes would hide as many packets as it is long.
        self.form = replace(self.form, calibration_blocks=0)

    def feed(self, data: bytes, arrival_s: float) -> list[Stamped]:
        """Take the next bytes, in pieces of any size; return the messages that they complete.

        Parameters
        ----------
        arrival_s
            LSL clock when they arrived; handed back with the messages that end in them.
        """
        found: list[Stamped] = []
        self._settled = False
        for start in range(0, len(data), _SLICE):
            self._buffer += data[start : start + _SLICE]
            self._arrivals.append((self._consumed + len(self._buffer), arrival_s))
            self._scan(found)
        return found

    def settle(self) -> list[Stamped]:
        """Nothing followed for a while: what could have been the beginning of more is complete."""
        found: list[Stamped] = []
        self._settled = True
        self._scan(found)
        return found

    def give_up(self) -> list[Stamped]:
        """Stop waiting for the rest of a message; return what was hidden behind its first byte."""
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
        """Size of the valid message at *start*: 0 if there is none, None if more must come."""
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
        """Tell whether a data packet is one; None if what follows must tell."""
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
        """Tell whether the packet behind goes on with the ticks of this one."""
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
