"""Says in a stream's header that it is played from a recording, and of which.

Below ``desc``, beside the recorded description, which stays as it is::

    <replay>
      <file>study.xdf</file> <source_id>amplifier-1</source_id>
      <nominal_srate>130.0</nominal_srate> <speed>1.0</speed> <start>4711.25</start>
    </replay>

The stream's own source_id begins with :data:`PREFIX`, so that no receiver takes it for the
recorded one come back. What is read comes from the network or a file and is not trusted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from biosensor_common.errors import SpecError, SpecReason

PREFIX = "replay:"
"""Begins the source_id of a stream that is played."""

_BLOCK = "desc/replay"
_MAX_CHARACTERS = 1024


@dataclass(frozen=True, slots=True)
class Replay:
    """Which stream of which recording is played, and how.

    Attributes
    ----------
    file
        Name of the recording, without its folder.
    source_id
        Of the stream as it was recorded; empty if it had none.
    rate
        Nominal rate as it was recorded in Hz, 0 if irregular.
    speed
        Seconds of the recording in one second.
    start_s
        Where in the recording it starts: LSL time of the computer that recorded, in s.
    """

    file: str
    source_id: str
    rate: float
    speed: float
    start_s: float

    @property
    def title(self) -> str:
        """The file, and the speed unless it is the recording's own."""
        return self.file if self.speed == 1 else f"{self.file} at {self.speed:g} times its speed"


def replay_source_id(file_hash: str, recorded: str) -> str:
    """Return the source_id of a played stream: the same whenever that recording is played.

    Parameters
    ----------
    file_hash
        By which the recording's content is known.
    recorded
        What tells the stream from the others in the recording: its source_id.
    """
    return f"{PREFIX}{file_hash}:{recorded}"


def mark_as_replay(desc: ET.Element, replay: Replay) -> None:
    """Put the block into a ``desc`` element, in place of one that is there."""
    for old in desc.findall("replay"):
        desc.remove(old)
    block = ET.SubElement(desc, "replay")
    for name, text in (
        ("file", replay.file),
        ("source_id", replay.source_id),
        ("nominal_srate", repr(replay.rate)),
        ("speed", repr(replay.speed)),
        ("start", repr(replay.start_s)),
    ):
        ET.SubElement(block, name).text = text


def read_replay(root: ET.Element) -> Replay | None:
    """Read the block of a stream's full description; None if there is none.

    Raises
    ------
    SpecError
        ``INVALID``, ``TOO_LARGE`` or, if it is not one block, ``MALFORMED``.
    """
    blocks = root.findall(_BLOCK)
    if not blocks:
        return None
    if len(blocks) > 1:
        raise SpecError(SpecReason.MALFORMED, "an LSL description has several <replay> blocks")
    text = {name: blocks[0].findtext(name) or "" for name in ("file", "source_id")}
    if any(len(each) > _MAX_CHARACTERS for each in text.values()):
        message = f"a name in a <replay> block is longer than {_MAX_CHARACTERS} characters"
        raise SpecError(SpecReason.TOO_LARGE, message)
    numbers = ("nominal_srate", "speed", "start")
    rate, speed, start_s = (_number(blocks[0], name) for name in numbers)
    if rate < 0 or speed <= 0:
        message = f"a <replay> block names {rate:g} Hz at {speed:g} times the speed"
        raise SpecError(SpecReason.INVALID, message)
    return Replay(text["file"], text["source_id"], rate, speed, start_s)


def recorded_source_id(source_id: str, replay: Replay | None) -> str:
    """Return the source_id that a stream had when it was measured, played or not."""
    return source_id if replay is None else replay.source_id


def _number(block: ET.Element, name: str) -> float:
    text = block.findtext(name) or ""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        message = f"a <replay> block has {text[:_MAX_CHARACTERS]!r} as <{name}>, which is no number"
        raise SpecError(SpecReason.INVALID, message)
    return number
