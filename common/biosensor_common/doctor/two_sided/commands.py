"""The tasks that the asking side gives the other one, and their answers."""

from __future__ import annotations

import re
from dataclasses import asdict
from enum import StrEnum, unique

from biosensor_common.doctor.two_sided.channel import Message
from biosensor_common.doctor.two_sided.code import is_nonce
from biosensor_common.doctor.two_sided.facts import Stream, read_streams
from biosensor_common.doctor.two_sided.open_ports import Targets
from biosensor_common.doctor.two_sided.reading import Reader
from biosensor_common.errors import ProtocolError, ProtocolReason

# It goes into a question to liblsl, which has a syntax.
_SOURCE_ID = re.compile(r"[a-z]+-[0-9a-f]{32}")


@unique
class Command(StrEnum):
    """In the order in which they are given.

    ``OPEN`` test ports and a test stream; ``SEND`` to the ports of the other one; ``LOOK`` for
    its test stream and list all real ones; ``KNOCK`` at the data ports of its streams;
    ``COMPARE`` what both have found out.
    """

    OPEN = "open"
    SEND = "send"
    LOOK = "look"
    KNOCK = "knock"
    COMPARE = "compare"


def with_targets(targets: Targets) -> Message:
    """Tell the ports that are open."""
    return {"targets": asdict(targets)}


def targets_of(message: Message) -> Targets:
    """Read them; raises `ProtocolError`."""
    read = Reader(message).inner("targets")
    return Targets(
        read.number("discovery", 0, 65535), tuple(read.ports("udp")), tuple(read.ports("tcp"))
    )


def with_streams(streams: tuple[Stream, ...]) -> Message:
    """Tell the streams of this computer."""
    return {"streams": [asdict(each) for each in streams]}


def streams_of(message: Message) -> tuple[Stream, ...]:
    """Read them; raises `ProtocolError`."""
    return read_streams(message.get("streams"))


def source_id_of(message: Message) -> str:
    """Read the name of the test stream; raises `ProtocolError`."""
    found = Reader(message).text("source_id")
    if not _SOURCE_ID.fullmatch(found):
        raise ProtocolError(ProtocolReason.GARBAGE, "the test stream's name is none of ours")
    return found


def run_of(message: Message) -> str:
    """Read the number of the test; raises `ProtocolError`."""
    found = message.get("run")
    if not is_nonce(found):
        raise ProtocolError(ProtocolReason.GARBAGE, "the number of the test is none of ours")
    return str(found)
