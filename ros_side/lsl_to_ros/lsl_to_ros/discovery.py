"""Which streams are there, and one inlet for each."""

from __future__ import annotations

from collections.abc import Callable, Container
from time import monotonic
from typing import NamedTuple

import pylsl

from lsl_to_ros.inlets import Inlet, InletState

# An outlet that has just died is still reported by the resolver for a while.
RETRY_S = 0.5
FORGET_AFTER_S = 5.0


class Changes(NamedTuple):
    """What is new since the last look."""

    ready: list[Inlet]
    gone: list[Inlet]


class Discovery:
    """Keeps one inlet for each stream on the network.

    An inlet is given up when its stream is lost or comes back under the same
    source_id, never because the resolver stopped seeing it: a cut network heals
    by itself, with its backlog.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn = warn
        self._resolver = pylsl.ContinuousResolver(forget_after=FORGET_AFTER_S)
        self._inlets: dict[str, Inlet] = {}
        self._announced: set[str] = set()
        self._not_before: dict[str, float] = {}
        self._successor: dict[str, str] = {}

    @property
    def inlets(self) -> list[Inlet]:
        """All present inlets."""
        return list(self._inlets.values())

    def update(self) -> Changes:
        """Open inlets for new streams; return those that became ready or ended."""
        gone = [inlet for inlet in self.inlets if inlet.state is InletState.LOST]
        for inlet in gone:
            self._not_before[inlet.uid] = monotonic() + RETRY_S
        found = {info.uid(): info for info in self._resolver.results()}
        for uid, info in found.items():
            if self._is_new(uid):
                gone += self._replaced_by(info)
                self._inlets[uid] = Inlet(info, self._warn)
        self._forget(gone, found)
        ready = [
            inlet
            for inlet in self.inlets
            if inlet.state is InletState.READY and inlet.uid not in self._announced
        ]
        self._announced.update(inlet.uid for inlet in ready)
        return Changes(ready, gone)

    def stop(self) -> None:
        """End all inlets."""
        for inlet in self.inlets:
            inlet.stop()
        for inlet in self.inlets:
            inlet.join(1.0)
        self._inlets.clear()

    def _is_new(self, uid: str) -> bool:
        if uid in self._inlets or monotonic() < self._not_before.get(uid, 0.0):
            return False
        # Two outlets may share a source_id; attaching to both in turn would lose samples.
        return self._successor.get(uid) not in self._inlets

    def _replaced_by(self, info: pylsl.StreamInfo) -> list[Inlet]:
        source_id = info.source_id()
        replaced = [inlet for inlet in self.inlets if source_id and inlet.source_id == source_id]
        for inlet in replaced:
            self._successor[inlet.uid] = info.uid()
        return replaced

    def _forget(self, gone: list[Inlet], found: Container[str]) -> None:
        for inlet in gone:
            inlet.stop()
            self._inlets.pop(inlet.uid, None)
            self._announced.discard(inlet.uid)
        for record in (self._not_before, self._successor):
            for uid in [uid for uid in record if uid not in found]:
                del record[uid]
