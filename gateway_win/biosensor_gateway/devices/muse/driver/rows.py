"""Puts together the packets of several channels that were measured at the same time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.muse.driver.packets import Floats, Packet

PATIENCE = 3
"""A channel that is missing so often in a row is taken for one that the device does not send."""


class Rows(NamedTuple):
    """Samples of all channels.

    Attributes
    ----------
    number
        Of the packets.
    samples : ndarray of float64, shape (n_samples, n_channels)
        NaN of a channel whose packet is missing.
    arrival_s
        Of the newest of their packets.
    """

    number: int
    samples: Floats
    arrival_s: float


class RowAssembler:
    """Collects the packets of channels that share their numbers.

    The channels of a moment come one after the other, so a packet of another number ends it.

    Parameters
    ----------
    channels
        How many there may be.
    samples
        In each packet.
    """

    def __init__(self, channels: int, samples: int) -> None:
        self._channels, self._samples = channels, samples
        self._held: dict[int, Floats] = {}
        self._number, self._arrival_s = 0, 0.0
        self._given_out: int | None = None
        self._absent = [0] * channels

    def take(self, channel: int, packet: Packet, arrival_s: float = 0.0) -> list[Rows]:
        """Return what is complete now: nothing, a moment, or two."""
        if packet.number == self._given_out:
            # It is later than it was waited for, or came twice: this moment has its rows.
            self._absent[channel] = 0
            return []
        if self._held and packet.number == self._number and channel in self._held:
            return []
        complete: list[Rows] = []
        if self._held and packet.number != self._number:
            complete.append(self._give_out())
        self._number, self._arrival_s = packet.number, arrival_s
        self._held[channel] = packet.samples
        self._absent[channel] = 0
        if all(at in self._held or self._absent[at] >= PATIENCE for at in range(self._channels)):
            complete.append(self._give_out())
        return complete

    def forget(self) -> None:
        """Begin anew: what is held is of an earlier connection."""
        self._held.clear()
        self._given_out = None

    def _give_out(self) -> Rows:
        rows = np.full((self._samples, self._channels), np.nan)
        for channel in range(self._channels):
            if channel in self._held:
                rows[:, channel] = self._held[channel]
            else:
                self._absent[channel] += 1
        self._held.clear()
        self._given_out = self._number
        return Rows(self._number, rows, self._arrival_s)
