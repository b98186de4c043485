"""Keeps pauses on disk, so that a new start of the agent does not end them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, cast

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.system import state_file

PAUSED_FILE = "paused.json"
_FIELDS = ("sensor", "unit", "participant", "label")


@dataclass(frozen=True, slots=True)
class Pause:
    """A pause as it is kept.

    Attributes
    ----------
    identity
        The device as the settings had it when it was paused.
    since
        Local time, with its offset.
    """

    identity: DeviceIdentity
    since: datetime

    def holds_for(self, identity: DeviceIdentity) -> bool:
        """Whether a device is the paused one, also if its settings were changed.

        It is if it has the same streams: the strap of that person was replaced. It is
        also if it is the same unit, unless another person wears it by now.
        """
        mine = self.identity
        if naming.source_id(mine, "") == naming.source_id(identity, ""):
            return True
        is_another_person = (
            bool(mine.participant and identity.participant)
            and mine.participant != identity.participant
        )
        same_unit = (mine.sensor, mine.unit) == (identity.sensor, identity.unit)
        return same_unit and not is_another_person


def load(folder: Path) -> list[Pause]:
    """Read the pauses that are kept in a state folder.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if there is a file and it cannot be understood: nobody knows
        then who has withdrawn.
    """
    path = folder / PAUSED_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return [_pause(entry) for entry in content["paused"]]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        message = (
            f"{path}: it cannot be read who has withdrawn ({error}), so nothing is streamed; "
            "correct the file, or remove it if nobody has"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def save(folder: Path, pauses: Iterable[Pause]) -> None:
    """Replace what is kept, in one step that also survives a loss of power.

    Raises
    ------
    OSError
        The folder cannot be written; what was kept before still is.
    """
    entries = [
        {name: getattr(each.identity, name) for name in _FIELDS} | {"since": each.since.isoformat()}
        for each in pauses
    ]
    path = folder / PAUSED_FILE
    if not entries:
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
        return
    state_file.replace(path, json.dumps({"paused": entries}, indent=1), durable=True)


def _pause(entry: Mapping[str, Any]) -> Pause:
    texts = [cast("object", entry[name]) for name in _FIELDS]
    if not all(isinstance(text, str) for text in texts):
        raise ValueError("a name is no text")
    return Pause(DeviceIdentity(*cast("list[str]", texts)), datetime.fromisoformat(entry["since"]))
