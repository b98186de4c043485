"""Parses heart rates in the manufacturer data of Polar's advertisements; no I/O, no clock.

Manufacturer data are a sequence of blocks. A block whose first byte has bit 6 set is of another
kind and has its length in the next byte. The heart rate is in a block without that bit, of 3
bytes, or 4 bytes with a second average [1]_. Bit 0 means that the battery is good, according to
the vendor's interface [2]_ and data from users' devices; a test of the vendor names it the other
way round.

References
----------
.. [1] https://github.com/polarofficial/polar-ble-sdk, classes ``BleAdvertisementContent`` and
   ``BlePolarHrAdvertisement``
.. [2] the same, class ``PolarHrBroadcastData``
"""

from __future__ import annotations

from typing import NamedTuple

COMPANY = 0x006B
COUNTS = 8
"""The counter has three bits and increases once a second."""

_BATTERY_OK = 1 << 0
_CONTACT = 1 << 1
_OTHER_KIND = 1 << 6
_SHORT, _LONG = 3, 4


class Broadcast(NamedTuple):
    """The contents of one heart rate block."""

    bpm: int  # The average displayed by devices [1/min]; 0 = no reading.
    fast_bpm: int  # Average over a shorter time; 0 = no reading or not included.
    contact: bool  # Whether the device reports skin contact.
    battery_ok: bool
    counter: int  # Counter of measurements, modulo `COUNTS`; some old devices do not count.


def parse(data: bytes) -> Broadcast | None:
    """Parse manufacturer data without the company id; None if they contain no heart rate."""
    at = 0
    while at < len(data) and data[at] & _OTHER_KIND:
        if at + 1 >= len(data):
            return None
        at += 2 + data[at + 1]
    block = data[at:]
    if len(block) not in {_SHORT, _LONG}:
        return None
    is_long = len(block) == _LONG
    return Broadcast(
        bpm=block[-1],
        fast_bpm=block[2] if is_long else 0,
        contact=bool(block[0] & _CONTACT),
        battery_ok=bool(block[0] & _BATTERY_OK),
        counter=block[0] >> 2 & COUNTS - 1,
    )
