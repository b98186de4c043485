"""Lists the programs that can record on this computer, the best first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.here.errors import RecorderError
from biosensor_gateway.recording.here.program import find_program
from biosensor_gateway.system.ansi_path import ansi_folder
from biosensor_gateway.system.child import own_command

RECORD_STREAMS = "record-streams"
"""First argument of the command line that records by our own means."""
LAB_RECORDER, OWN = "LabRecorder's program", "the gateway's own recorder"


@dataclass(frozen=True, slots=True)
class Way:
    """A program that is given a file and a predicate, and records until a line comes in.

    Attributes
    ----------
    title
        For a sentence.
    command
        Its command line up to the file.
    """

    title: str
    command: tuple[str, ...]


def find_ways(folder: Path) -> tuple[list[Way], list[str]]:
    """Return them in the order in which they are tried, and what is said of those not here.

    Parameters
    ----------
    folder
        Has the settings of LSL, by which sessions and peers are told.
    """
    own = Way(OWN, tuple(own_command([RECORD_STREAMS])))
    try:
        program = find_program()
    except RecorderError as error:
        return [own], [str(error)]
    if ansi_folder(folder) is None:
        message = (
            f"{LAB_RECORDER} cannot read the LSL session and peers in {folder}, whose name has "
            "letters that this Windows' code page lacks"
        )
        return [own], [message]
    return [Way(LAB_RECORDER, (str(program),)), own], []
