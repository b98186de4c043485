"""Opens what is to be played, and names the reasons for which it is not."""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from enum import Enum, unique
from pathlib import Path
from tempfile import TemporaryDirectory

from biosensor_common.errors import GatewayError
from biosensor_gateway.recording.contents.opening import Contents, open_contents
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason


@unique
class ReplayReason(Enum):
    """What keeps a recording from being played."""

    LIVE = "live"
    """A stream that is to be played is on the network, measured now."""
    PLAYED = "played"
    """Somebody plays this recording already."""
    EMPTY = "empty"
    """There is no sample to play."""
    NO_OUTLET = "no_outlet"
    """LSL cannot offer a stream."""
    REFUSED = "refused"
    """The process that was to play it says why, for any of these reasons or another."""


class ReplayError(GatewayError):
    """A recording is not played."""


_BAGS = frozenset({".mcap", ".db3"})
_HASH_CHARACTERS = 12


@contextmanager
def opened(path: Path) -> Generator[Contents]:
    """Open a recording, or a bag of ROS by way of one in the folder for temporary files.

    Raises
    ------
    BagError
        If a bag cannot be read, or no recording made of it.
    RecordingError
        If there is no such file, it cannot be read, or it is no XDF file.
    """
    if path.is_dir() or path.suffix.lower() in _BAGS:
        with _imported(path) as recording, open_contents(recording) as contents:
            yield contents
        return
    with open_contents(path) as contents:
        yield contents


@contextmanager
def _imported(bag: Path) -> Generator[Path]:
    """Turn a bag into a recording that is gone at the end."""
    from biosensor_gateway.recording.bag.importing import import_bag  # noqa: PLC0415 - rosbags

    with TemporaryDirectory(prefix="biosensor-gateway-replay-") as folder:
        # Its name is in the headers.
        recording = Path(folder, bag.resolve().name)
        import_bag(bag, recording)
        yield recording


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
