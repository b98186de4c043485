"""Opens what is to be played."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.contents.opening import Contents, open_contents
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_BAGS = frozenset({".mcap", ".db3"})
_HASH_CHARACTERS = 12


@contextmanager
def opened(path: Path) -> Generator[Contents]:
    """Open a recording.

    Raises
    ------
    ConfigError
        ``UNREADABLE``, if it is a bag.
    RecordingError
        If there is no such file, it cannot be read, or it is no XDF file.
    """
    if path.is_dir() or path.suffix.lower() in _BAGS:
        message = f"{path} is a bag of ROS; only XDF files can be played"
        raise ConfigError(ConfigReason.UNREADABLE, message)
    with open_contents(path) as contents:
        yield contents


def content_hash(path: Path) -> str:
    """Return what tells a recording from any other, whatever its file is called.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:_HASH_CHARACTERS]
    except OSError as error:
        message = f"{path} cannot be read: {error.strerror or error}"
        raise RecordingError(RecordingReason.UNREADABLE, message) from error
