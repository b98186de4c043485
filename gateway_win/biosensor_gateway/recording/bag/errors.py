"""Reasons for which a bag cannot be used."""

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
    """There is nothing in it that a recording can hold."""
    EXISTS = "exists"
    """The file to write is there already."""
    UNWRITABLE = "unwritable"
    """The file cannot be written."""


class BagError(GatewayError):
    """Nothing of the bag can be read, or nothing can be written of it."""


class MessageError(Exception):
    """A message, or its type, makes no sense; the text is the rest of a sentence."""


class UnsuitableError(MessageError):
    """No message of a topic fits a recording; the text is the rest of a sentence."""
