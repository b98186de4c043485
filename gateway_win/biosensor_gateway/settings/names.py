"""The rule for participants' names: new names have only letters and digits.

BIDS labels allow nothing else, and such names need no change in file names, LSL names and ROS
topics. Other names in existing settings and recordings stay valid; :func:`label` converts them.
"""

from __future__ import annotations

import re
import unicodedata
from hashlib import sha256

from biosensor_common.errors import ConfigError, ConfigReason

LABEL = re.compile(r"[A-Za-z0-9]+")
"""A BIDS label, see https://bids-specification.readthedocs.io."""
MAX_LENGTH = 32
"""Maximum length of a name that is a part of stream names."""
_MOST_CHARACTERS = 40
_HASH_CHARACTERS = 6
_NOT_OF_A_LABEL = re.compile(r"[^0-9A-Za-z]+")


def label(text: str) -> str:
    """Return the letters and digits of a text, for a BIDS label.

    Accents are removed. A result that is empty or cut gets a hash of the text, so that different
    texts have different labels.
    """
    plain = _plain(text)
    if plain and len(plain) <= _MOST_CHARACTERS:
        return plain
    return plain[: _MOST_CHARACTERS - _HASH_CHARACTERS] + _hash(text)


def require_participant(name: str) -> str:
    """Return a participant's name if it is valid.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if it has other characters than letters and digits, or too many.
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
