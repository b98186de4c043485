"""Reads secrets from the environment, else from the operating system's keyring.

Secrets are never in the settings file, the command line, a log or an error message.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import keyring
from keyring.errors import KeyringLocked, NoKeyringError, PasswordDeleteError

from biosensor_common.errors import CredentialError, CredentialReason

SERVICE = "biosensor-gateway"

_T = TypeVar("_T")


class Secret:
    """Text that `repr` and `str` hide, so that it is not logged by accident."""

    __slots__ = ("_text",)

    def __init__(self, text: str) -> None:
        self._text = text

    def reveal(self) -> str:
        """Return the text, to send it to its service."""
        return self._text

    def __repr__(self) -> str:
        return "Secret(***)"

    def __str__(self) -> str:
        return "***"

    def __reduce__(self) -> str:
        raise TypeError("a secret is never written")


@dataclass(frozen=True, slots=True)
class SecretName:
    """Name of a secret of a sensor; drivers declare theirs."""

    sensor: str
    name: str  # Unique for the sensor.
    variable: str  # Environment variable with the secret; it takes precedence over the keyring.
    title: str

    @property
    def entry(self) -> str:
        """User name of the secret in the keyring."""
        return f"{self.sensor}.{self.name}"


def find_secret(name: SecretName) -> Secret:
    """Look up a secret; blocks while the keyring asks its user to unlock it.

    Raises
    ------
    CredentialError
        ``MISSING`` if the secret is not found, or there is no keyring.
    """
    from_environment = _from_environment(name)
    if from_environment:
        return Secret(from_environment)
    stored = _asked(name, lambda: keyring.get_password(SERVICE, name.entry))
    if not stored:
        message = (
            f"{name.title} is not known; set {name.variable} or store it with "
            f"`biosensor-gateway secrets set {name.sensor}`"
        )
        raise CredentialError(CredentialReason.MISSING, message)
    return Secret(stored)


def secret_origin(name: SecretName) -> str:
    """Return where `find_secret` finds a secret, for people.

    Raises
    ------
    CredentialError
        As `find_secret` does.
    """
    find_secret(name)
    return f"from {name.variable}" if _from_environment(name) else "from the keyring"


def set_secret(name: SecretName, text: str) -> None:
    """Store a secret in the keyring.

    Raises
    ------
    CredentialError
        ``MISSING`` if there is no keyring, ``REJECTED`` if the text is empty.
    """
    if not text.strip():
        raise CredentialError(CredentialReason.REJECTED, f"{name.title} must not be empty")
    _asked(name, lambda: keyring.set_password(SERVICE, name.entry, text.strip()))


def forget_secret(name: SecretName) -> bool:
    """Remove a secret from the keyring; return whether it was there.

    Raises
    ------
    CredentialError
        ``MISSING``, if there is no keyring.
    """

    def forget() -> bool:
        if keyring.get_password(SERVICE, name.entry) is None:
            return False
        try:
            keyring.delete_password(SERVICE, name.entry)
        except PasswordDeleteError:
            # Another program has removed it in between.
            return False
        return True

    return _asked(name, forget)


def _from_environment(name: SecretName) -> str:
    return os.environ.get(name.variable, "").strip()


def _asked(name: SecretName, call: Callable[[], _T]) -> _T:
    try:
        return call()
    except NoKeyringError:
        problem = f"this computer has no keyring; set {name.variable} or install a keyring"
    except KeyringLocked:
        problem = f"the keyring is locked; unlock it or set {name.variable}"
    except Exception as error:  # noqa: BLE001 - backends pass on whatever their system raises
        problem = f"the keyring fails ({type(error).__name__}); set {name.variable} instead"
    # Raised outside the handlers, so that a backend's message, which may quote the secret, is not
    # chained to it.
    raise CredentialError(CredentialReason.MISSING, f"{name.title}: {problem}")
