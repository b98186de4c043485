"""Puts the parts of a packet together that did not fit into one notification.

Nothing in a part says whether another one follows. A packet is complete when it is as long as
those of its measurement are; if none ever is, what comes before the next first part is.
"""

from __future__ import annotations

from typing import NamedTuple

from biosensor_gateway.devices.movesense.driver.payloads import STAMP_BYTES
from biosensor_gateway.devices.movesense.driver.protocol import Kind, Message


class Packet(NamedTuple):
    """A complete payload and the LSL time at which its last part arrived."""

    payload: bytes
    arrival_s: float


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
