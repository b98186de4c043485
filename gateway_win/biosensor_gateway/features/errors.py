"""Reasons for which features are not computed."""

from __future__ import annotations

from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class FeatureReason(Enum):
    """What keeps features from being computed of a stream or a recording."""

    UNIT = "unit"
    """A unit is missing, or is none that is known here."""
    RATE = "rate"
    """The stream has no nominal rate, or one at which nothing can be found."""
    FORMAT = "format"
    """It does not have numbers, or too few channels."""
    NOTHING = "nothing"
    """There is no stream that features are computed of."""
    EXISTS = "exists"
    """A file is in the way and would be overwritten."""
    UNWRITABLE = "unwritable"
    """The file cannot be written."""


class FeatureError(GatewayError):
    """Features are not computed; the message says of what, and why."""
