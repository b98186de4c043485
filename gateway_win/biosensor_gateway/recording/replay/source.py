"""Opens the recording to replay, and defines the errors of a replay."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from enum import Enum, unique
from pathlib import Path
from tempfile import TemporaryDirectory

from biosensor_common.errors import GatewayError
from biosensor_gateway.recording.contents.contents import Contents, open_contents, open_ended
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason


@unique
class ReplayReason(Enum):
    """Why a recording cannot be replayed."""

    LIVE = "live"
    """The real stream is on the network now."""
    PLAYED = "played"
    """This recording is already being replayed."""
    EMPTY = "empty"
    """There are no samples to play."""
    NO_OUTLET = "no_outlet"
    """LSL cannot offer a stream."""
    REFUSED = "refused"
    """The player process failed, for any of these reasons or another."""


class ReplayError(GatewayError):
    """A recording cannot be replayed."""


_BAGS = frozenset({".mcap", ".db3"})
_HASH_CHARACTERS = 12


@contextmanager
def opened(path: Path) -> Generator[Contents]:
    """Open a recording, or a ROS bag that is converted to a temporary recording.

    Raises
    ------
    BagError
        If a bag cannot be read or converted.
    ConfigError
        ``IN_USE`` if it is still being recorded.
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file.
    """
    if path.is_dir() or path.suffix.lower() in _BAGS:
        with _imported(path) as recording, open_contents(recording) as contents:
            yield contents
        return
    with open_ended(path) as contents:
        yield contents


@contextmanager
def _imported(bag: Path) -> Generator[Path]:
    """Convert a bag to a temporary recording."""
    from biosensor_gateway.recording.bag.conversion import import_bag  # noqa: PLC0415 - rosbags

    with TemporaryDirectory(prefix="biosensor-gateway-replay-") as folder:
        # Named like the bag, because the headers of played streams contain the file name.
        recording = Path(folder, bag.resolve().name)
        import_bag(bag, recording)
        yield recording


def content_hash(path: Path) -> str:
    """Return a hash of a recording's content, which identifies it whatever its file name.

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
