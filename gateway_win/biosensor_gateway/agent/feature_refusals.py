"""Says in the agent's status what the programs that compute live features do not pass on.

They are other processes, beside the agent or started by hand. Each keeps a file of its own in the
state folder while there is something to say.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel

from biosensor_common import naming
from biosensor_common.refusals import Refusals
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.status import (
    AgentStatus,
    DeviceStatus,
    RefusedStatus,
    declared_streams,
)
from biosensor_gateway.system import state_file

STALE_AFTER_S = 5.0
_NAME = "features-{process}.json"


class _Told(BaseModel):
    written: float
    refusals: list[RefusedStatus]


class FeatureRefusals:
    """The file of this process.

    Parameters
    ----------
    folder
        The state folder of the agent that is to tell it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME.format(process=os.getpid())

    def write(self, refusals: Refusals) -> None:
        """Write what was reported so far, if anything was; what cannot be is written next time."""
        told = RefusedStatus.of(refusals)
        if told:
            with contextlib.suppress(OSError):
                text = _Told(written=time.time(), refusals=told).model_dump_json()
                state_file.replace(self._path, text)

    def close(self) -> None:
        """Say nothing any more; a file that cannot be removed says so by its age."""
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)


def read(folder: Path) -> list[RefusedStatus]:
    """Return what programs that compute features say now; the files of those that ended go."""
    found: list[RefusedStatus] = []
    for path in sorted(folder.glob(_NAME.format(process="*"))):
        try:
            told = _Told.model_validate_json(state_file.read(path))
        except (OSError, ValueError):
            # Windows refuses while it is replaced, and a second later does not.
            continue
        if abs(time.time() - told.written) <= STALE_AFTER_S:
            found += told.refusals
        else:
            with contextlib.suppress(OSError):
                path.unlink()
    return found


def add(status: AgentStatus, told: Sequence[RefusedStatus]) -> None:
    """Add to a status what is said of features: to the stream that they are of, or to the agent."""
    streams = {
        name: device.streams[source]
        for device in (status.devices if told else ())
        for name, source in _names(device).items()
        if source in device.streams
    }
    for each in told:
        sentence = each.sentence.removeprefix(f"{each.about}: ")
        if (stream := streams.get(each.about)) is not None:
            more = {"about": "", "sentence": f"its live features: {sentence}"}
            stream.refusals.append(each.model_copy(update=more))
        else:
            more = {"sentence": f"live features of {each.about}: {sentence}"}
            status.refusals.append(each.model_copy(update=more))


def _names(device: DeviceStatus) -> dict[str, str]:
    """Return the source_id of each stream of a device, by what LSL calls it."""
    identity = DeviceIdentity(device.sensor, device.unit, device.participant, device.label)
    return {
        naming.lsl_name(identity, each.data_name): naming.source_id(identity, each.data_name)
        for each in declared_streams(device.sensor, device.declared)
    }
