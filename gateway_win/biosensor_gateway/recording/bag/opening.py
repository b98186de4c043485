"""Opens a bag: a folder of ``ros2 bag record``, or one of its files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from biosensor_gateway.recording.bag.errors import BagError, BagReason, MessageError
from biosensor_gateway.recording.bag.mcap_file import read_mcap
from biosensor_gateway.recording.bag.messages import Message, Note
from biosensor_gateway.recording.bag.sqlite_file import read_sqlite
from biosensor_gateway.recording.bag.unpacking import ZSTD_MAGIC, unpack_zstd

_READERS: Mapping[str, Callable[[Path, Note], Iterator[Message]]] = {
    ".mcap": read_mcap,
    ".db3": read_sqlite,
}
_MOST_MESSAGE_BYTES = 1 << 28


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order.

    The metadata beside them are not needed, because a recorder that died wrote none.

    Raises
    ------
    BagError
        If it is no bag.
    """
    if not path.exists():
        raise BagError(BagReason.NOT_FOUND, f"there is no file or folder {path}")
    if not path.is_dir():
        if path.suffix not in _READERS:
            message = f"{path} is no bag: that is a folder, or a file that ends in .mcap or .db3"
            raise BagError(BagReason.NOT_A_BAG, message)
        return [path]
    files = [each for each in path.iterdir() if each.suffix in _READERS]
    if not files:
        packed = any(each.suffix == ".zstd" for each in path.iterdir())
        what = (
            "whose files are compressed; unpack them by zstd" if packed else "without a bag's file"
        )
        raise BagError(BagReason.NOT_A_BAG, f"{path} is a folder {what}")
    return sorted(files, key=_place)


def read_bag(path: Path, note: Note) -> Iterator[Message]:
    """Give all messages of a bag that can be read, in the order in which they were written.

    Parameters
    ----------
    note
        Is told what cannot be read.

    Raises
    ------
    BagError
        If nothing can be read.
    """
    for file in bag_files(path):
        try:
            for message in _READERS[file.suffix](file, note):
                if message.content.startswith(ZSTD_MAGIC):
                    yield from _unpacked(message, note)
                else:
                    yield message
        except OSError as error:
            text = f"cannot read {file}: {error.strerror or error}"
            raise BagError(BagReason.UNREADABLE, text) from error


def _unpacked(message: Message, note: Note) -> Iterator[Message]:
    """Give a message of a bag whose messages are compressed one by one."""
    try:
        yield message._replace(content=unpack_zstd(message.content, _MOST_MESSAGE_BYTES))
    except MessageError as error:
        note(f"{message.topic.name}: a message is left out ({error})")


def _place(path: Path) -> tuple[list[int], str]:
    """Order ``bag_2`` before ``bag_10``."""
    return [int(number) for number in re.findall(r"\d+", path.stem)[-1:]], path.name
