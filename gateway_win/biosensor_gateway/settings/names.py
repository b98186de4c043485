"""The one rule for the names that people are given: what is typed again has letters and digits.

BIDS labels take nothing else, and file names, LSL names and ROS topics carry these as they are.
Settings and recordings that have other names stay valid; :func:`label` says what they become.
"""

from __future__ import annotations

import re
import unicodedata
from hashlib import sha256

from biosensor_common.errors import ConfigError, ConfigReason

LABEL = re.compile(r"[A-Za-z0-9]+")
"""What BIDS takes as a label, https://bids-specification.readthedocs.io."""
MAX_LENGTH = 32
"""Characters of a name that becomes a part of stream names."""
_MOST_CHARACTERS = 40
_HASH_CHARACTERS = 6
_NOT_OF_A_LABEL = re.compile(r"[^0-9A-Za-z]+")


def label(text: str) -> str:
    """Return letters and digits of a text: BIDS allows no other in its labels.

    Letters lose their accents. Where nothing is left, or it is cut, it gets a hash of the text,
    so that different ones stay different.
    """
    plain = _plain(text)
    if plain and len(plain) <= _MOST_CHARACTERS:
        return plain
    return plain[: _MOST_CHARACTERS - _HASH_CHARACTERS] + _hash(text)


def require_participant(name: str) -> str:
    """Return a participant's name that somebody has typed.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if it has other characters than letters and digits, or too many.
    """
    if LABEL.fullmatch(name) and len(name) <= MAX_LENGTH:
        return name
    proposal = _plain(name)[:MAX_LENGTH] or "P01"
    message = (
        f"{name!r} cannot be a participant's name: use 1 to {MAX_LENGTH} letters and digits, "
        f"such as {proposal}"
    )
    raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _plain(text: str) -> str:
    return _NOT_OF_A_LABEL.sub("", unicodedata.normalize("NFKD", text))


def _hash(text: str) -> str:
    return sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_HASH_CHARACTERS]
