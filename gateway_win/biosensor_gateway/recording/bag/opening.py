"""Opens a bag: a folder of ``ros2 bag record``, or one of its files."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from biosensor_gateway.recording.bag.errors import BagError, BagReason, MessageError
from biosensor_gateway.recording.bag.mcap_file import read_mcap
from biosensor_gateway.recording.bag.messages import Message, Note, Topic
from biosensor_gateway.recording.bag.unpacking import ZSTD_MAGIC, unpack_zstd, unpack_zstd_file

# What is damaged may be in the library's own words, too.
_UNREADABLE = (sqlite3.Error, UnicodeDecodeError, OverflowError)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def read_sqlite(path: Path, note: Note) -> Iterator[Message]:
    """Give all messages that can be read, in the order in which they were recorded.

    Parameters
    ----------
    note
        Is told what cannot be read.

    Raises
    ------
    BagError
        ``NOT_A_BAG`` if it is another file.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        database.text_factory = _text
        try:
            topics = _topics(database)
        except _UNREADABLE as error:
            message = f"{path} is no bag: {error}"
            raise BagError(BagReason.NOT_A_BAG, message) from error
        try:
            rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
            for number, unix_ns, content in rows:
                topic = topics.get(number)
                if topic and isinstance(content, bytes) and isinstance(unix_ns, int):
                    yield Message(topic, unix_ns, content)
        except _UNREADABLE as error:
            note(f"{path} is damaged ({error}); what comes before was read")


def _topics(database: sqlite3.Connection) -> dict[int, Topic]:
    definitions = _definitions(database)
    rows = database.execute(
        "SELECT id, name, type, offered_qos_profiles FROM topics WHERE serialization_format = 'cdr'"
    )
    topics: dict[int, Topic] = {}
    for number, name, type_name, qos in rows:
        encoding, text = definitions.get(type_name, ("", ""))
        topics[number] = Topic(str(name), str(type_name), encoding, text, str(qos or ""))
    return topics


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Return encoding and text by type; bags of before ROS 2 Iron have none."""
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {str(name): (str(encoding), str(text)) for name, encoding, text in rows}
    except _UNREADABLE:
        return {}


_READERS: Mapping[str, Callable[[Path, Note], Iterator[Message]]] = {
    ".mcap": read_mcap,
    ".db3": read_sqlite,
}
_PACKED = ".zstd"
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
        if _unpacked_path(path).suffix not in _READERS:
            message = f"{path} is no bag: that is a folder, or a file that ends in .mcap or .db3"
            raise BagError(BagReason.NOT_A_BAG, message)
        return [path]
    # A recorder that died while it packed a file has left both; the plain one comes last here.
    found = {_unpacked_path(each): each for each in sorted(path.iterdir(), reverse=True)}
    files = [each for plain, each in found.items() if plain.suffix in _READERS]
    if not files:
        raise BagError(BagReason.NOT_A_BAG, f"{path} is a folder without a bag's file")
    return sorted(files, key=lambda each: _place(_unpacked_path(each)))


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
            with _plain(file, note) as plain:
                for message in _READERS[plain.suffix](plain, note):
                    if message.content.startswith(ZSTD_MAGIC):
                        yield from _unpacked(message, note)
                    else:
                        yield message
        except BagError as error:
            if file.suffix != _PACKED:
                raise
            # The reader knows the file that it was unpacked into alone.
            note(f"{file.name}: nothing of it can be read ({error.reason.name.lower()})")
        except OSError as error:
            text = f"cannot read {file}: {error.strerror or error}"
            raise BagError(BagReason.UNREADABLE, text) from error


def _unpacked_path(path: Path) -> Path:
    return path.with_suffix("") if path.suffix == _PACKED else path


@contextmanager
def _plain(file: Path, note: Note) -> Generator[Path]:
    """Give a file that can be read: itself, or what it holds packed, as far as that is whole."""
    if file.suffix != _PACKED:
        yield file
        return
    with TemporaryDirectory(prefix="biosensor-gateway-bag-") as folder:
        plain = Path(folder, _unpacked_path(file).name)
        try:
            unpack_zstd_file(file, plain)
        except MessageError as error:
            note(f"{file.name}: {error}")
        yield plain


def _unpacked(message: Message, note: Note) -> Iterator[Message]:
    """Give a message of a bag whose messages are compressed one by one."""
    try:
        yield message._replace(content=unpack_zstd(message.content, _MOST_MESSAGE_BYTES))
    except MessageError as error:
        note(f"{message.topic.name}: a message is left out ({error})")


def _place(path: Path) -> tuple[list[int], str]:
    """Order ``bag_2`` before ``bag_10``."""
    return [int(number) for number in re.findall(r"\d+", path.stem)[-1:]], path.name
