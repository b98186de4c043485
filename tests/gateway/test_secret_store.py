"""Secrets: where they come from, and that they show nowhere."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator

import keyring
import pytest
from keyring.backend import KeyringBackend
from keyring.backends import fail
from keyring.errors import KeyringLocked, PasswordDeleteError, PasswordSetError

from biosensor_common.errors import CredentialError, CredentialReason
from biosensor_gateway.settings.secrets import (
    SERVICE,
    Secret,
    SecretName,
    find_secret,
    forget_secret,
    set_secret,
)

NAME = SecretName("some_sensor", "client_id", "SOME_CLIENT_ID", "the client id")
OTHER = SecretName("some_sensor", "client_secret", "SOME_CLIENT_SECRET", "the client secret")
PLANTED = "planted-5f1c"


class MemoryKeyring(KeyringBackend):
    """A keyring that keeps everything to itself; `error` is raised instead, if there is one."""

    # Never chosen by itself: other tests have the user's own, or none.
    priority = 0  # pyright: ignore[reportAssignmentType] - a classproperty of the library

    def __init__(self) -> None:
        super().__init__()
        self.entries: dict[tuple[str, str], str] = {}
        self.error: Exception | None = None

    def get_password(self, service: str, username: str) -> str | None:
        self._fail()
        return self.entries.get((service, username))

    def set_password(self, service: str, username: str, password: str) -> None:
        self._fail()
        self.entries[service, username] = password

    def delete_password(self, service: str, username: str) -> None:
        self._fail()
        del self.entries[service, username]

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Generator[MemoryKeyring]:
    for name in (NAME, OTHER):
        monkeypatch.delenv(name.variable, raising=False)
    before = keyring.get_keyring()
    memory = MemoryKeyring()
    keyring.set_keyring(memory)
    yield memory
    keyring.set_keyring(before)


def test_a_secret_is_stored_found_and_forgotten(store: MemoryKeyring) -> None:
    set_secret(NAME, f" {PLANTED}\n")
    assert store.entries == {(SERVICE, "some_sensor.client_id"): PLANTED}
    assert find_secret(NAME).reveal() == PLANTED
    assert forget_secret(NAME)
    assert not forget_secret(NAME)
    assert store.entries == {}


def test_the_environment_goes_before_the_keyring(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_secret(NAME, "stored")
    monkeypatch.setenv(NAME.variable, f"{PLANTED}\n")
    assert find_secret(NAME).reveal() == PLANTED
    monkeypatch.setenv(NAME.variable, " ")
    assert find_secret(NAME).reveal() == "stored"
    assert store.error is None


def test_one_may_come_from_here_and_one_from_there(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NAME.variable, "from the environment")
    set_secret(OTHER, "from the keyring")
    assert find_secret(NAME).reveal() == "from the environment"
    assert find_secret(OTHER).reveal() == "from the keyring"
    assert len(store.entries) == 1


def test_a_secret_that_is_nowhere_is_missed_by_name(store: MemoryKeyring) -> None:
    with pytest.raises(CredentialError, match=r"the client id.*SOME_CLIENT_ID") as raised:
        find_secret(NAME)
    assert raised.value.reason is CredentialReason.MISSING
    assert store.entries == {}


def test_the_environment_needs_no_keyring(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.error = RuntimeError("must not be asked")
    monkeypatch.setenv(NAME.variable, PLANTED)
    assert find_secret(NAME).reveal() == PLANTED


@pytest.mark.usefixtures("store")
def test_a_computer_without_a_keyring_is_told_in_one_sentence() -> None:
    keyring.set_keyring(fail.Keyring())
    asked: tuple[Callable[[], object], ...] = (
        lambda: find_secret(NAME),
        lambda: forget_secret(NAME),
        lambda: set_secret(NAME, PLANTED),
    )
    for ask in asked:
        with pytest.raises(CredentialError) as raised:
            ask()
        assert raised.value.reason is CredentialReason.MISSING
        assert "no keyring; set SOME_CLIENT_ID or install a keyring" in str(raised.value)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "error",
    [KeyringLocked("x"), PasswordSetError(PLANTED), OSError(PLANTED), RuntimeError(PLANTED)],
)
def test_no_failure_of_a_keyring_quotes_a_secret(store: MemoryKeyring, error: Exception) -> None:
    store.error = error
    with pytest.raises(CredentialError) as raised:
        set_secret(NAME, PLANTED)
    assert NAME.variable in str(raised.value)
    assert PLANTED not in str(raised.value)
    assert raised.value.__cause__ is None
    assert raised.value.__context__ is None


def test_a_secret_that_somebody_else_has_just_forgotten_is_forgotten(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_secret(NAME, PLANTED)

    def too_late(service: str, username: str) -> None:
        raise PasswordDeleteError(service, username)

    monkeypatch.setattr(store, "delete_password", too_late)
    assert not forget_secret(NAME)


@pytest.mark.parametrize("text", ["", " ", "\n"])
def test_nothing_is_no_secret(store: MemoryKeyring, text: str) -> None:
    with pytest.raises(CredentialError) as raised:
        set_secret(NAME, text)
    assert raised.value.reason is CredentialReason.REJECTED
    assert store.entries == {}


def test_a_secret_shows_itself_only_when_asked() -> None:
    secret = Secret(PLANTED)
    shown = (
        str(secret),
        repr(secret),
        f"{secret}",
        f"{secret!r:>20}",
        str([secret]),
    )
    assert not any(PLANTED in text for text in shown)
    assert secret.reveal() == PLANTED
    with pytest.raises(TypeError):
        pickle.dumps(secret)
    assert not hasattr(secret, "__dict__")
