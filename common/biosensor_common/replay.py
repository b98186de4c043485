"""Marks a stream as the replay of a recording, in its header.

The block is below ``desc``, in addition to the unchanged recorded description::

    <replay>
      <file>study.xdf</file> <source_id>amplifier-1</source_id>
      <nominal_srate>130.0</nominal_srate> <speed>1.0</speed> <start>4711.25</start>
    </replay>

The stream's own source_id begins with :data:`PREFIX`, so that no receiver takes it for the
recorded stream. Blocks come from the network or a file and are not trusted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from biosensor_common.errors import SpecError, SpecReason

PREFIX = "replay:"
"""Prefix of the source_id of a replayed stream."""

_BLOCK = "desc/replay"
_MAX_CHARACTERS = 1024


@dataclass(frozen=True, slots=True)
class Replay:
    """The recording and the stream that are replayed, and how.

    Attributes
    ----------
    file
        Name of the recording, without its folder.
    source_id
        The recorded source_id; empty if there was none.
    rate
        Recorded nominal rate in Hz, 0 if irregular.
    speed
        Seconds of the recording per second.
    start_s
        Start of the replay in the recording: LSL time of the recording computer, in s.
    """

    file: str
    source_id: str
    rate: float
    speed: float
    start_s: float

    @property
    def title(self) -> str:
        """The file name, with the speed unless it is 1."""
        return self.file if self.speed == 1 else f"{self.file} at {self.speed:g} times its speed"


def replay_source_id(file_hash: str, recorded: str) -> str:
    """Return the source_id of a replayed stream, the same for each replay of a recording.

    Parameters
    ----------
    file_hash
        Hash of the recording's content.
    recorded
        Identifies the stream in the recording: its source_id.
    """
    return f"{PREFIX}{file_hash}:{recorded}"


def mark_as_replay(desc: ET.Element, replay: Replay) -> None:
    """Put the block into a ``desc`` element, replacing an existing one."""
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
    """Parse the block of a stream's full description; None if there is none.

    Raises
    ------
    SpecError
        ``INVALID``, ``TOO_LARGE``, or ``MALFORMED`` for several blocks.
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
    """Return the source_id that a stream had when it was measured, also for a replay."""
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
