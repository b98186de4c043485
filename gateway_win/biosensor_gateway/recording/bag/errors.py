"""Errors of bags."""

from __future__ import annotations

from enum import Enum, unique

from biosensor_common.errors import GatewayError


@unique
class BagReason(Enum):
    """Why a bag cannot be read at all."""

    NOT_FOUND = "not_found"
    UNREADABLE = "unreadable"
    NOT_A_BAG = "not_a_bag"
    EMPTY = "empty"
    """It contains nothing that fits a recording."""
    EXISTS = "exists"
    """The output file exists."""
    UNWRITABLE = "unwritable"
    """The output file cannot be written."""


class BagError(GatewayError):
    """The bag cannot be read, or no file can be written from it."""


class MessageError(Exception):
    """A message or its type is invalid; the text is the end of a sentence."""


class UnsuitableError(MessageError):
    """No message of a topic fits a recording; the text is the end of a sentence."""
