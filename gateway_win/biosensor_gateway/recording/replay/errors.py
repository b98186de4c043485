"""Reasons for which a recording is not played."""

from __future__ import annotations

from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class ReplayReason(Enum):
    """What keeps a recording from being played."""

    LIVE = "live"
    """A stream that is to be played is on the network, measured now."""
    PLAYED = "played"
    """Somebody plays this recording already."""
    EMPTY = "empty"
    """There is no sample to play."""
    NO_OUTLET = "no_outlet"
    """LSL cannot offer a stream."""
    REFUSED = "refused"
    """The process that was to play it says why, for any of these reasons or another."""


class ReplayError(GatewayError):
    """A recording is not played."""
