"""Heart rates in the manufacturer data of Polar's advertisements; no I/O, no clock.

Manufacturer data are blocks behind each other. A block whose first byte has bit 6 set is of
another kind and tells its length in the next byte; the heart rate is in one without that bit,
of 3 bytes, or 4 with a second average [1]_. A set bit 0 means that the battery will do: so the
vendor's interface says [2]_, and so it is in what devices of users sent; a test of the vendor's
names it the other way round.

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
"""The counter has three bits and goes up once a second."""

_BATTERY_OK = 1 << 0
_CONTACT = 1 << 1
_OTHER_KIND = 1 << 6
_SHORT, _LONG = 3, 4


class Broadcast(NamedTuple):
    """What one block says.

    Attributes
    ----------
    bpm
        The average that devices show [1/min]; 0 = no reading.
    fast_bpm
        Over a shorter time; 0 = no reading, or not told.
    contact
        Whether the device says that it feels the skin.
    counter
        Of the measurements, modulo `COUNTS`; some old devices do not count.
    """

    bpm: int
    fast_bpm: int
    contact: bool
    battery_ok: bool
    counter: int


def parse(data: bytes) -> Broadcast | None:
    """Read manufacturer data, without the company's number; None if no heart rate is in them."""
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
