"""A recorder in a process of its own: ``python -m tests.faults.scenarios.receiver FILE CHANNELS``.

CHANNELS is JSON: how many channels each stream has, by source_id. It says ``all`` once it
has a sample of every stream and, when its standard input is closed, writes what came into
FILE, for :func:`read`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pylsl

from benchmarks.child import Orders, say
from tests.faults.recorder import Recorded, Recorder

_POLL_S = 0.1


class Received(NamedTuple):
    """What a receiver has met and got."""

    names: dict[str, str]  # LSL name of each outlet, by its uid.
    recorded: dict[str, Recorded]  # Samples, by source_id.


def read(path: Path) -> Received:
    """Return what a receiver has written."""
    with np.load(path) as arrays:
        names = json.loads(str(arrays["names"]))
        sources = [name.removesuffix(".times") for name in arrays.files if name.endswith(".times")]
        return Received(names, {each: _recorded(arrays, each) for each in sources})


def _recorded(arrays: np.lib.npyio.NpzFile, source: str) -> Recorded:
    times = arrays[f"{source}.times"]
    return Recorded(times, arrays[f"{source}.values"], times)


def main(path: Path, channels: dict[str, int]) -> None:
    orders, resolver = Orders(), pylsl.ContinuousResolver()
    with Recorder(channels) as recorder:
        has_all = False
        while not orders.closed.wait(_POLL_S):
            if not has_all and all(map(recorder.newest, channels)):
                has_all = True
                say("all")
        infos = [info for info in resolver.results() if info.source_id()]
        arrays = {"names": np.array(json.dumps({info.uid(): info.name() for info in infos}))}
        for source in channels:
            times, values, _ = recorder.recorded(source)
            arrays |= {f"{source}.times": times, f"{source}.values": values}
    np.savez(path, allow_pickle=False, **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
