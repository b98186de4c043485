"""Compares whose recording a file's name says it is with who wore its sensors."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum, unique
from pathlib import Path
from typing import NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.selection import device_name
from biosensor_gateway.settings.names import label

GROUP = "group"
"""How a file's participant begins that stands for several people."""
_ENTITY = re.compile(r"(sub|ses|task|acq|run)-([0-9A-Za-z]+)")
_MOST_NAMED = 6


class Worn(NamedTuple):
    """A sensor, as ``polar_h10/A1``, and who wears it; empty for nobody."""

    sensor: str
    participant: str

    @classmethod
    def by(cls, identity: DeviceIdentity) -> Worn:
        """Return the same of a device or of a stream's header."""
        return cls(device_name(identity), identity.participant)


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A file whose name says another participant than its sensors.

    Attributes
    ----------
    named
        Whose recording its name says it is.
    others
        Who else wears its sensors.
    is_all
        Whether `named` wears none of them.
    """

    named: str
    others: tuple[str, ...]
    is_all: bool
    sentence: str


@unique
class Whose(StrEnum):
    """Who is right where a file's name says another participant than its sensors."""

    SENSORS = "sensors"
    NAME = "name"


class OtherParticipantsError(ConfigError):
    """Nobody has confirmed that a file is to be called after somebody else than its sensors."""

    def __init__(self, mismatch: Mismatch) -> None:
        message = (
            f"{mismatch.sentence}; correct one of them, or confirm it with --other-participants"
        )
        super().__init__(ConfigReason.WRONG_VALUE, message)
        self.mismatch = mismatch


def compare(named: str, worn: Iterable[Worn]) -> Mismatch | None:
    """Say in what a file's participant and those of its sensors differ; None if they agree.

    A file without a participant agrees with all, and so does a sensor without one. So does a
    participant such as ``group07`` if several people wear the sensors.

    Parameters
    ----------
    named
        The participant by the file's name; empty if it says none.
    worn
        The sensors in it, in an order that a person knows.
    """
    sensors = [each for each in dict.fromkeys(worn) if each.participant]
    people = list(dict.fromkeys(each.participant for each in sensors))
    others = tuple(each for each in people if not _is_same(named, each))
    is_group = len(people) > 1 and named.lower().startswith(GROUP)
    if not named or not others or is_group:
        return None
    is_all = len(others) == len(people)
    if is_all:
        sentence = f"the file is called {named}, but its sensors are worn by {listed(others)}"
    else:
        wrong = [each for each in sensors if each.participant in others]
        whose = " and ".join(_worn_by(each, wrong) for each in others[:_MOST_NAMED])
        sentence = f"the file is called {named}, but {whose}"
    return Mismatch(named, others, is_all, sentence)


def compare_file(path: Path, identities: Iterable[DeviceIdentity | None]) -> Mismatch | None:
    """Compare a file's name with the identities in the headers of its streams; see `compare`."""
    worn = [Worn.by(each) for each in identities if each is not None]
    return compare(participant_of(path), worn)


def participant_of(path: Path) -> str:
    """Return whose recording a file's name says it is; empty if it says nobody."""
    return entities_of(path.name.partition(".")[0]).get("sub", "")


def entities_of(name: str) -> dict[str, str]:
    """Return what a name says that is made as BIDS has it, by ``sub``, ``ses``, ``task`` ...

    ``biosensor-gateway record`` and LabRecorder make such names; of others, it is empty.
    """
    matches = (_ENTITY.fullmatch(part) for part in name.split("_"))
    found = {match[1]: match[2] for match in matches if match}
    if not found.get("run", "0").isdigit():
        del found["run"]
    return found


def listed(names: Iterable[str]) -> str:
    """Return names as a person lists them: ``P01, P02 and P03``."""
    every = list(names)
    if len(every) > _MOST_NAMED:
        every = [*every[:_MOST_NAMED], f"{len(every) - _MOST_NAMED} more"]
    return " and ".join(filter(None, [", ".join(every[:-1]), every[-1]])) if every else ""


def _is_same(named: str, participant: str) -> bool:
    # As in a data set of BIDS, where P-01 is P01, and capitals tell nobody apart.
    return label(named).lower() == label(participant).lower()


def _worn_by(participant: str, sensors: Iterable[Worn]) -> str:
    own = [each.sensor for each in sensors if each.participant == participant]
    return f"{participant} wears {listed(own)}"
