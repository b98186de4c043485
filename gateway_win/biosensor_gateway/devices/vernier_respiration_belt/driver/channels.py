"""The two channels of a belt that are recorded, and the period that both can have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import Channel


@dataclass(frozen=True, slots=True)
class BeltChannels:
    """Force, and the respiration rate that the belt computes from it."""

    force: Channel
    rate: Channel

    @property
    def mask(self) -> int:
        """Both as a mask, bit n for channel n."""
        return 1 << self.force.number | 1 << self.rate.number

    def period_us(self, wanted_us: int) -> int:
        """Return the sampling period next to the wanted one that the belt can have.

        A belt measures all channels with one period.
        """
        both = (self.force, self.rate)
        least = max(channel.min_period_us for channel in both)
        most = max(least, min(channel.max_period_us for channel in both))
        step = max(1, *(channel.granularity_us for channel in both))
        period = round(min(max(wanted_us, least), most) / step) * step
        if period < least:
            return period + step
        return period - step if period > most and period - step >= least else period


def choose_channels(channels: Sequence[Channel]) -> BeltChannels:
    """Find force and rate by what the belt says of its channels.

    Raises
    ------
    ProtocolError
        ``UNSUPPORTED``, if one of them is missing.
    """
    force = [each for each in channels if each.description.casefold() == "force"]
    rate = [each for each in channels if each.description.casefold() == "respiration rate"]
    if not force or not rate:
        names = ", ".join(each.description for each in channels) or "nothing"
        message = f"the device measures {names}: it is no respiration belt; set another `device`"
        raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
    return BeltChannels(force[0], rate[0])
