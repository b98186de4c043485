"""The code that a person carries from one computer to the other, and what is made of it."""

from __future__ import annotations

import hashlib
import hmac
import secrets

from biosensor_common.errors import CredentialError, CredentialReason

DIGITS = 6
_NONCE_BYTES = 16
# So that who read the greeting along cannot try all codes before the conversation has ended.
_ROUNDS = 200_000


def new_code() -> str:
    """Return a code that nobody can know."""
    return f"{secrets.randbelow(10**DIGITS):0{DIGITS}d}"


def read_code(text: str) -> str:
    """Return a code as it was typed, without blanks and hyphens.

    Raises
    ------
    CredentialError
        ``REJECTED``, if it cannot be one.
    """
    code = text.replace(" ", "").replace("-", "")
    if len(code) != DIGITS or not (code.isascii() and code.isdecimal()):
        raise CredentialError(
            CredentialReason.REJECTED,
            f"{text!r} is no code; type the {DIGITS} digits that the other computer shows",
        )
    return code


def nonce() -> str:
    """Return a number that is used once, in hexadecimal digits."""
    return secrets.token_hex(_NONCE_BYTES)


def is_nonce(text: object) -> bool:
    """Whether this is a number as `nonce` makes them."""
    if not isinstance(text, str) or len(text) != 2 * _NONCE_BYTES:
        return False
    return all(digit in "0123456789abcdef" for digit in text)


def key(code: str, asking: str, answering: str) -> bytes:
    """Return the key of one conversation, made of the code and of the nonces of both."""
    salt = f"{asking}:{answering}".encode("ascii")
    return hashlib.pbkdf2_hmac("sha256", code.encode("ascii"), salt, _ROUNDS)


def seal(key: bytes, words: bytes) -> str:
    """Return what proves that words come from somebody who has the key."""
    return hmac.new(key, words, hashlib.sha256).hexdigest()


def is_sealed(key: bytes, words: bytes, given: str) -> bool:
    """Whether a seal is right; takes as long whether it is or not."""
    return hmac.compare_digest(seal(key, words).encode("ascii"), given.encode("ascii", "replace"))
