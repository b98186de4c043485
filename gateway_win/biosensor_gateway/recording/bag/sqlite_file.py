"""Reads a bag that is a database of SQLite."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from biosensor_gateway.recording.bag.errors import BagError, BagReason
from biosensor_gateway.recording.bag.messages import Message, Note, Topic

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
