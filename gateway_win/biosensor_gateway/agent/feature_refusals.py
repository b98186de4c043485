"""Adds to the agent's status what programs with live features do not pass on.

They are other processes, started by the agent or by hand. Each writes its own file into the state
folder while it has something to report.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pydantic import BaseModel

from biosensor_common import naming
from biosensor_common.refusal import Refusal, Refusals
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


_LASTING = frozenset(each.word for each in Refusal if each.stands)


class _Report(BaseModel):
    written: float
    refusals: list[RefusedStatus]


class FeatureRefusals:
    """The file of this process, in an agent's state folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME.format(process=os.getpid())

    def write(self, refusals: Refusals) -> None:
        """Write the refusals, if there are any; after a failure the next call writes them."""
        refused = RefusedStatus.of(refusals)
        if refused:
            with contextlib.suppress(OSError):
                text = _Report(written=time.time(), refusals=refused).model_dump_json()
                state_file.replace(self._path, text)

    def close(self) -> None:
        """Remove the file; one that cannot be removed is ignored once it is old."""
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)


def read(folder: Path) -> list[RefusedStatus]:
    """Return what programs with live features report now; remove files of ended programs."""
    found: list[RefusedStatus] = []
    for path in sorted(folder.glob(_NAME.format(process="*"))):
        try:
            report = _Report.model_validate_json(state_file.read(path))
        except (OSError, ValueError):
            # Windows refuses to open a file while it is replaced; a second later it works.
            continue
        if abs(time.time() - report.written) <= STALE_AFTER_S:
            found += report.refusals
        else:
            with contextlib.suppress(OSError):
                path.unlink()
    return found


def add(status: AgentStatus, refused: Sequence[RefusedStatus]) -> None:
    """Add refusals of features to the status of their raw stream, else to that of the agent."""
    streams = {
        name: device.streams[source]
        for device in (status.devices if refused else ())
        for name, source in _names(device).items()
        if source in device.streams
    }
    said: set[tuple[str, bool]] = set()
    for each in refused:
        if (each.sentence, each.now) in said:
            continue  # nothing is dropped: both of two programs that send the same say so
        said.add((each.sentence, each.now))
        sentence = each.sentence.removeprefix(f"{each.about}: ")
        if (stream := streams.get(each.about)) is not None:
            more = {"about": "", "sentence": f"its live features: {sentence}"}
            stream.refusals.append(each.model_copy(update=more))
        else:
            more = {"sentence": f"live features of {each.about}: {sentence}"}
            status.refusals.append(each.model_copy(update=more))


def problems(
    refused: Iterable[RefusedStatus], since_s: float
) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield refusals of features as heartbeats have them, by the LSL name of the raw stream.

    Parameters
    ----------
    since_s
        LSL time in seconds; what happened last before it is left out, unless it lasts.
    """
    for each in refused:
        lasts = each.what in _LASTING
        if each.now if lasts else each.last_s >= since_s:
            sentence = f"live features of {each.sentence}"
            yield each.about, {"what": sentence, **({} if lasts else {"last": each.last_s})}


def _names(device: DeviceStatus) -> dict[str, str]:
    """Return the source_ids of a device's streams by their LSL names."""
    identity = DeviceIdentity(device.sensor, device.unit, device.participant, device.label)
    return {
        naming.lsl_name(identity, each.data_name): naming.source_id(identity, each.data_name)
        for each in declared_streams(device.sensor, device.declared)
    }
