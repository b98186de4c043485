"""Every error that a caller can do something about.

::

    GatewayError
    ├── TransportError   the bytes do not flow: port, radio, socket
    ├── ProtocolError    the bytes flow, but the device does not keep to its protocol
    ├── SpecError        a declaration or a stream's LSL description is wrong
    ├── ConfigError      the user's settings are wrong
    └── CredentialError  a secret is missing or was refused

Callers decide by class and ``reason``, never by the text. The text is one
sentence for a person: what, where, what to do.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable
from enum import Enum, unique
from pathlib import Path
from typing import Generic, TypeVar


@unique
class TransportReason(Enum):
    """Why bytes do not flow."""

    ABSENT = "absent"
    """The device is not there: no such port, connection refused, no advertisement."""
    BUSY = "busy"
    """Another program uses it."""
    DENIED = "denied"
    """The operating system refuses access."""
    LOST = "lost"
    """The connection was lost."""
    SILENT = "silent"
    """The link is up, but no byte arrives."""
    UNAVAILABLE = "unavailable"
    """This machine lacks the radio or service."""
    EXHAUSTED = "exhausted"
    """The system lets the program open no more files."""


@unique
class ProtocolReason(Enum):
    """How a device breaks its protocol."""

    GARBAGE = "garbage"
    """Bytes arrive, but none of them make a valid packet."""
    NO_REPLY = "no_reply"
    """A command was not answered."""
    REFUSED = "refused"
    """The device refused a command."""
    UNSUPPORTED = "unsupported"
    """The device is of a kind or version that the driver does not know."""


@unique
class SpecReason(Enum):
    """What is wrong with a declaration or a description."""

    INVALID = "invalid"
    """A field has a value that the rules forbid."""
    UNKNOWN_SENSOR = "unknown_sensor"
    MALFORMED = "malformed"
    """Not well-formed XML, or a field is missing or repeated."""
    TOO_LARGE = "too_large"
    """Over the size limit."""
    UNKNOWN_VERSION = "unknown_version"
    CONTRADICTORY = "contradictory"
    """The description contradicts the stream's core fields."""


@unique
class ConfigReason(Enum):
    """What is wrong with the settings."""

    NOT_FOUND = "not_found"
    UNREADABLE = "unreadable"
    MALFORMED = "malformed"
    UNKNOWN_KEY = "unknown_key"
    WRONG_VALUE = "wrong_value"
    EXISTS = "exists"
    """A file exists and would be overwritten."""
    IN_USE = "in_use"
    """Another agent uses the same state folder."""


@unique
class CredentialReason(Enum):
    """What is wrong with a secret."""

    MISSING = "missing"
    REJECTED = "rejected"


_ReasonT = TypeVar("_ReasonT", bound=Enum)


class GatewayError(Exception):
    """Base class of this project's errors; callers decide by ``reason``."""

    def __init__(self, reason: Enum, message: str) -> None:
        super().__init__(message)
        self._reason = reason

    @property
    def reason(self) -> Enum:
        """The reason, a member of the class's enum."""
        return self._reason


class _ReasonedError(GatewayError, Generic[_ReasonT]):
    """Narrows ``reason`` to one enum, for the type checker."""

    def __init__(self, reason: _ReasonT, message: str) -> None:
        super().__init__(reason, message)
        self._narrowed = reason

    @property
    def reason(self) -> _ReasonT:
        return self._narrowed


class TransportError(_ReasonedError[TransportReason]):
    """The bytes do not flow."""


class ProtocolError(_ReasonedError[ProtocolReason]):
    """The device does not keep to its protocol."""


class SpecError(_ReasonedError[SpecReason]):
    """A declaration or an LSL description is wrong."""


class ConfigError(_ReasonedError[ConfigReason]):
    """The user's settings are wrong."""


class CredentialError(_ReasonedError[CredentialReason]):
    """A secret is missing or was refused."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `` (did you mean 'NAME'?)`` to append to a sentence; empty if no name is similar."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


_ERROR_SHARING_VIOLATION = 32
"""Windows' error of a file that another program has open."""
_ADVICE = {
    errno.EACCES: "choose another place, or get permission to write there",
    errno.EPERM: "choose another place, or get permission to write there",
    errno.EROFS: "choose a place on another disk",
    errno.ENOSPC: "free some space on that disk, or choose a place on another one",
    errno.EDQUOT: "free some space there, or choose a place on another disk",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOENT: "make its folder first, or choose another place",
    errno.ENOTDIR: "choose a place in a folder",
    errno.EISDIR: "choose the name of a file",
    errno.EBUSY: "close the program that has it open",
    errno.ETXTBSY: "close the program that has it open",
}


def cannot_write(path: Path | str, error: OSError) -> str:
    """Return the sentence for a file that could not be written, and what to do if that is known."""
    is_open = getattr(error, "winerror", None) == _ERROR_SHARING_VIOLATION
    advice = _ADVICE.get(errno.EBUSY if is_open else error.errno or 0)
    return f"cannot write {path}: {error.strerror or error}{f'; {advice}' if advice else ''}"
