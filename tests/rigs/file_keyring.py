"""A keyring in a file, for processes; ``FILE_KEYRING`` says where the file is."""

from __future__ import annotations

import json
import os
from pathlib import Path

from keyring.backend import KeyringBackend
from keyring.errors import PasswordDeleteError

BACKEND = "tests.rigs.file_keyring.FileKeyring"
VARIABLE = "FILE_KEYRING"


def environment(path: Path) -> dict[str, str]:
    """What a process needs to use the file as its keyring."""
    return {
        "PYTHON_KEYRING_BACKEND": BACKEND,
        "PYTHONPATH": str(Path(__file__).parents[2]),
        VARIABLE: str(path),
    }


def entries(path: Path) -> dict[str, str]:
    """Passwords by ``service/username``."""
    return json.loads(path.read_text()) if path.exists() else {}


def put(path: Path, entry: str, password: str) -> None:
    """Store a password under ``service/username``."""
    path.write_text(json.dumps({**entries(path), entry: password}))


class FileKeyring(KeyringBackend):
    """Chosen by name alone."""

    priority = 0  # pyright: ignore[reportAssignmentType] - a classproperty of the library

    def get_password(self, service: str, username: str) -> str | None:
        return entries(self._path).get(f"{service}/{username}")

    def set_password(self, service: str, username: str, password: str) -> None:
        put(self._path, f"{service}/{username}", password)

    def delete_password(self, service: str, username: str) -> None:
        known = entries(self._path)
        if known.pop(f"{service}/{username}", None) is None:
            raise PasswordDeleteError
        self._path.write_text(json.dumps(known))

    @property
    def _path(self) -> Path:
        return Path(os.environ[VARIABLE])
