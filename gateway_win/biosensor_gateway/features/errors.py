"""Reasons why features are not computed."""

from __future__ import annotations

from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class FeatureReason(Enum):
    """Why features of a stream or a recording are not computed."""

    UNIT = "unit"
    """A unit is missing or unknown."""
    RATE = "rate"
    """The stream has no nominal rate, or one that is unsuitable for detection."""
    FORMAT = "format"
    """The stream does not have numbers, or has too few channels."""
    NOTHING = "nothing"
    """There is no stream from which features are computed."""
    EXISTS = "exists"
    """A file would be overwritten."""
    UNWRITABLE = "unwritable"
    """The file cannot be written."""


class FeatureError(GatewayError):
    """Features are not computed; the message says of which stream, and why."""
