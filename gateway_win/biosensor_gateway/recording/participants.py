"""Compares the participant in a file's name with those who wore the sensors."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum, unique
from pathlib import Path
from typing import NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.naming import label
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_states import device_name

GROUP = "group"
"""Prefix of a file's participant that stands for several people."""
_ENTITY = re.compile(r"(sub|ses|task|acq|run)-([0-9A-Za-z]+)")
_MOST_NAMED = 6


class Worn(NamedTuple):
    """A sensor, such as ``polar_h10/A1``, and its participant, empty if none is set."""

    sensor: str
    participant: str

    @classmethod
    def by(cls, identity: DeviceIdentity) -> Worn:
        """Return the sensor and participant of an identity."""
        return cls(device_name(identity), identity.participant)


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A file whose name and sensors have different participants."""

    named: str  # Participant in the file's name.
    others: tuple[str, ...]  # Other participants who wear its sensors.
    is_all: bool  # Whether `named` wears none of its sensors.
    sentence: str


@unique
class Whose(StrEnum):
    """The right participant if a file's name and its sensors have different ones."""

    SENSORS = "sensors"
    NAME = "name"


class OtherParticipantsError(ConfigError):
    """The file's name has another participant than its sensors, without confirmation."""

    def __init__(self, mismatch: Mismatch) -> None:
        message = (
            f"{mismatch.sentence}; correct one of them, or confirm it with --other-participants"
        )
        super().__init__(ConfigReason.WRONG_VALUE, message)
        self.mismatch = mismatch


def compare(named: str, worn: Iterable[Worn], *, any_case: bool = False) -> Mismatch | None:
    """Compare the participant in a file's name with those of its sensors; None if they agree.

    A file or sensor without a participant agrees with any. A file agrees with the one person whose
    BIDS label it has, because exports have the sensors' names: two spellings are two people in
    them. A participant such as ``group07`` agrees if several people wear the sensors.

    Parameters
    ----------
    named
        The participant in the file's name; empty if there is none.
    worn
        The sensors in it, in a meaningful order.
    any_case
        Whether upper and lower case are equal.
    """
    sensors = [each for each in dict.fromkeys(worn) if each.participant]
    people = list(dict.fromkeys(each.participant for each in sensors))
    same = sorted(
        (each for each in people if _is_same(named, each, any_case=any_case)),
        key=lambda each: each != named,
    )
    others = tuple(each for each in people if each not in same[:1])
    is_group = len(people) > 1 and named.lower().startswith(GROUP)
    if not named or not others or is_group:
        return None
    is_all = not same
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
    # LabRecorder's window makes the names of its files lower-case.
    return compare(participant_of(path), worn, any_case=True)


def participant_of(path: Path) -> str:
    """Return the participant in a file's name; empty if there is none."""
    return entities_of(path.name.partition(".")[0]).get("sub", "")


def entities_of(name: str) -> dict[str, str]:
    """Return the entities of a BIDS file name, by ``sub``, ``ses``, ``task`` ...

    ``biosensor-gateway record`` and LabRecorder use such names; for others it is empty.
    """
    matches = (_ENTITY.fullmatch(part) for part in name.split("_"))
    found = {match[1]: match[2] for match in matches if match}
    if not found.get("run", "0").isdigit():
        del found["run"]
    return found


def listed(names: Iterable[str]) -> str:
    """Return names as an English list: ``P01, P02 and P03``."""
    every = list(names)
    if len(every) > _MOST_NAMED:
        every = [*every[:_MOST_NAMED], f"{len(every) - _MOST_NAMED} more"]
    return " and ".join(filter(None, [", ".join(every[:-1]), every[-1]])) if every else ""


def _is_same(named: str, participant: str, *, any_case: bool) -> bool:
    # As in BIDS datasets, P-01 equals P01.
    one, other = label(named), label(participant)
    return one == other or (any_case and one.lower() == other.lower())


def _worn_by(participant: str, sensors: Iterable[Worn]) -> str:
    own = [each.sensor for each in sensors if each.participant == participant]
    return f"{participant} wears {listed(own)}"
