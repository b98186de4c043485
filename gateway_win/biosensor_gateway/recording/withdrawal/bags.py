"""Rewrites a bag without the data of one person."""

from __future__ import annotations

import shutil
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from biosensor_gateway.recording.withdrawal.texts import is_in_message
from biosensor_gateway.recording.withdrawal.traces import Person

METADATA = "metadata.yaml"


def is_bag(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return (folder / METADATA).is_file()


def topics_of(folder: Path, person: Person) -> tuple[list[str], int]:
    """Return a person's topics, and the number of other people's topics.

    Raises
    ------
    Exception
        Any of the library's, if it cannot be read.
    """
    with Reader(folder) as reader:
        names = list(dict.fromkeys(each.topic for each in reader.connections))
    own = [each for each in names if person.is_in(each)]
    return own, len(names) - len(own)


def write_without(folder: Path, target: Path, person: Person) -> None:
    """Copy it without the person's topics, and without messages that name them.

    Raises
    ------
    Exception
        Any of the library's, if it cannot be read or written.
    """
    plugin = StoragePlugin.SQLITE3 if list(folder.glob("*.db3*")) else StoragePlugin.MCAP
    made = target.with_name(f"{target.name}.made")
    shutil.rmtree(made, ignore_errors=True)
    try:
        with Reader(folder) as reader, Writer(made, version=9, storage_plugin=plugin) as writer:
            given: dict[int, Connection] = {}
            for each in reader.connections:
                if person.is_in(each.topic):
                    continue
                qos = getattr(each.ext, "offered_qos_profiles", [])
                given[each.id] = writer.add_connection(
                    each.topic,
                    each.msgtype,
                    msgdef=each.msgdef.data,
                    rihs01=each.digest,
                    offered_qos_profiles=qos,
                )
            for connection, unix_ns, content in reader.messages():
                kept = given.get(connection.id)
                if kept is not None and not is_in_message(content, person):
                    writer.write(kept, unix_ns, content)
        made.rename(target)
    finally:
        shutil.rmtree(made, ignore_errors=True)
