"""Finds streams, and opens one inlet for each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from itertools import count
from time import monotonic
from typing import NamedTuple

import pylsl

from biosensor_common import open_files
from biosensor_common.errors import SpecError
from biosensor_common.lsl.predicates import (
    EVERYTHING,
    Predicate,
    all_of,
    any_of,
    equals,
    none_of,
    of_user,
)
from biosensor_common.naming import NODE
from biosensor_common.quantities import ContentType
from lsl_to_ros.lsl.inlets import FROM_ROS, Inlet, InletState
from lsl_to_ros.lsl.rivals import Rivals, Swap
from lsl_to_ros.lsl.share import ALL, Share

# An outlet that has just died is still reported by the resolver for a while.
RETRY_S = 0.5
RETRY_FAILED_S = 5.0
FORGET_AFTER_S = 5.0
# An outlet that is reported for longer after another took its place is alive.
ALIVE_AFTER_S = FORGET_AFTER_S + 2.0
STOP_TIMEOUT_S = 1.0
_ROS_BLOCK = "desc/ros"


class Changes(NamedTuple):
    """What is new since the last look."""

    ready: list[Inlet]
    gone: list[Inlet]


class Discovery:
    """Keeps one inlet for each stream on the network, or of a share of them.

    The agents' counts of losses are kept whatever the share: they are of all streams. Streams
    that ``ros_to_lsl`` makes of topics are left out, unless the predicate itself asks for
    ``desc/ros``: they would go round in a circle.

    An inlet is given up when its stream is lost or comes back under the same
    source_id, never because the resolver stopped seeing it: a cut network heals
    by itself, with its backlog. Where it does not within some seconds after the
    resolver sees the stream again, a second inlet is opened, and the first that
    brings something stays (:class:`~lsl_to_ros.lsl.rivals.Rivals`).
    """

    def __init__(
        self, warn: Callable[[str], None], predicate: str = "", share: Share = ALL
    ) -> None:
        self._warn = warn
        self._predicate = _wanted(predicate)
        self._share = share
        self._resolver = _resolver(self._predicate)
        self._inlets: dict[str, Inlet] = {}
        self._announced: set[str] = set()
        self._order: dict[str, int] = {}
        self._numbers = count()
        self._not_before: dict[str, float] = {}
        self._left_out: dict[str, float] = {}
        self._refused: set[str] = set()
        self._twins: dict[str, pylsl.StreamInfo] = {}
        self._crowded_out: dict[str, str] = {}
        self._rivals = Rivals(warn)

    @property
    def inlets(self) -> list[Inlet]:
        """All present inlets."""
        return list(self._inlets.values())

    @property
    def refused(self) -> int:
        """How many of the present streams cannot be used."""
        return len(self._refused)

    @property
    def crowded_out(self) -> Collection[str]:
        """Names of the present streams for which this process may open no more files."""
        return self._crowded_out.values()

    def twins(self, inlet: Inlet) -> list[str]:
        """Return the computers of live senders that are left out because they claim to be this."""
        found = [info for info in self._twins.values() if inlet.continues_as(info)]
        return sorted(info.hostname() for info in found)

    def set_predicate(self, predicate: str) -> None:
        """Serve other streams from now on.

        Parameters
        ----------
        predicate
            LSL query; empty for all streams.

        Raises
        ------
        SpecError
            ``INVALID``, if a bracket or a quote in it has no partner.
        """
        wanted = _wanted(predicate)
        if wanted != self._predicate:
            self._predicate = wanted
            self._resolver = _resolver(wanted)

    def update(self) -> Changes:
        """Open inlets for new streams; return those that became ready or ended."""
        gone = self._ended()
        found = {info.uid(): info for info in self._resolver.results() if self._is_for_us(info)}
        swaps = self._swaps(gone, found)
        gone += [swap.old for swap in swaps if swap.old not in gone]
        for uid, info in found.items():
            self._order.setdefault(uid, next(self._numbers))
            if self._is_new(uid) and not self._is_superseded(info):
                gone += self._open(info)
        self._close(gone)
        self._inlets.update((swap.new.uid, swap.new) for swap in swaps)
        self._forget_all_but(found)
        self._warn_of_duplicates(found)
        ready = [
            inlet
            for inlet in self.inlets
            if inlet.state is InletState.READY and inlet.uid not in self._announced
        ]
        for inlet in ready:
            inlet.is_served = self._is_to_be_served(inlet)
            self._announced.add(inlet.uid)
        return Changes(ready, gone)

    def stop(self) -> None:
        """End all inlets."""
        self._rivals.stop()
        closing = [inlet.stop() for inlet in self.inlets]
        deadline = monotonic() + STOP_TIMEOUT_S
        for thread in closing:
            thread.join(max(0.0, deadline - monotonic()))
        self._inlets.clear()

    def _ended(self) -> list[Inlet]:
        ended: list[Inlet] = []
        for inlet in self.inlets:
            wait = {InletState.LOST: RETRY_S, InletState.FAILED: RETRY_FAILED_S}.get(inlet.state)
            if wait is not None:
                self._not_before[inlet.uid] = monotonic() + wait
            if inlet.state is InletState.REFUSED:
                self._refused.add(inlet.uid)
                ended.append(inlet)
            elif wait is not None or self._is_served_otherwise(inlet):
                ended.append(inlet)
        return ended

    def _swaps(self, ended: list[Inlet], found: Mapping[str, pylsl.StreamInfo]) -> list[Swap]:
        """Return who takes the place of inlets that have ended or are given up."""
        followed = [Swap(old, new) for old in ended if (new := self._rivals.successor(old))]
        present = {uid: inlet for uid, inlet in self._inlets.items() if inlet not in ended}
        return followed + self._rivals.look(present, found)

    def _is_served_otherwise(self, inlet: Inlet) -> bool:
        """Whether the predicate has changed for a stream since it was announced."""
        is_announced = inlet.uid in self._announced
        return is_announced and self._is_to_be_served(inlet) is not inlet.is_served

    def _is_to_be_served(self, inlet: Inlet) -> bool:
        is_wanted = inlet.matches(self._predicate) and self._share.has(inlet.info)
        return is_wanted and (not inlet.is_from_ros or _asks_for_ros(self._predicate))

    def _is_for_us(self, info: pylsl.StreamInfo) -> bool:
        if _is_of_a_node(info):
            return False
        return self._share.has(info) or info.type() == ContentType.COUNTERS

    def _open(self, info: pylsl.StreamInfo) -> list[Inlet]:
        """Open an inlet; return those that it replaces."""
        if not self._has_room(info):
            return []
        try:
            inlet = Inlet(info, self._warn)
        except SpecError as error:
            self._warn(f"an LSL stream is ignored: {error}")
            self._refused.add(info.uid())
            return []
        replaced = [other for other in self.inlets if other.continues_as(info)]
        self._inlets[inlet.uid] = inlet
        self._left_out.pop(inlet.uid, None)
        return replaced

    def _has_room(self, info: pylsl.StreamInfo) -> bool:
        """Whether an inlet fits beside those that are there and those that are being opened."""
        uid = info.uid()
        opening = sum(each.state is InletState.OPENING for each in self.inlets)
        has_room = open_files.has_room((1 + opening) * open_files.INLET)
        if has_room:
            self._crowded_out.pop(uid, None)
            return True
        if opening:
            # They have some of their files already, and there may be room when they have all.
            self._not_before[uid] = monotonic() + RETRY_S
            return False
        self._not_before[uid] = monotonic() + RETRY_FAILED_S
        if uid not in self._crowded_out:
            self._crowded_out[uid] = info.name()
            self._warn(str(open_files.exhausted(f"the stream {info.name()} is left out")))
        return False

    def _is_new(self, uid: str) -> bool:
        if uid in self._inlets or uid in self._refused:
            return False
        return monotonic() >= self._not_before.get(uid, 0.0)

    def _is_superseded(self, info: pylsl.StreamInfo) -> bool:
        """Whether an outlet that appeared later took the place of this one.

        The earlier one is dead and still reported; or both live and share a source_id,
        where attaching to them in turn would lose samples of both.
        """
        uid = info.uid()
        later = [inlet for inlet in self.inlets if self._order[inlet.uid] > self._order[uid]]
        if not any(inlet.continues_as(info) for inlet in later):
            return False
        self._left_out.setdefault(uid, monotonic())
        return True

    def _warn_of_duplicates(self, found: Mapping[str, pylsl.StreamInfo]) -> None:
        """Say that a live outlet is left out because a later one claims to be the same stream."""
        for uid, since in self._left_out.items():
            if monotonic() - since > ALIVE_AFTER_S and uid not in self._twins:
                self._twins[uid] = found[uid]
                name, host = found[uid].name(), found[uid].hostname()
                self._warn(
                    f"two LSL streams {name!r} share a source_id; that on {host} is left out"
                )

    def _close(self, gone: list[Inlet]) -> None:
        for inlet in gone:
            inlet.stop()
            self._rivals.close(inlet.uid)
            self._inlets.pop(inlet.uid, None)
            self._announced.discard(inlet.uid)

    def _forget_all_but(self, found: Mapping[str, pylsl.StreamInfo]) -> None:
        known = found.keys() | self._inlets.keys()
        for record in (self._not_before, self._left_out, self._order, self._crowded_out):
            for uid in record.keys() - known:
                del record[uid]
        for uid in self._twins.keys() - (found.keys() & self._left_out.keys()):
            del self._twins[uid]
        self._refused.intersection_update(found)


def _is_of_a_node(info: pylsl.StreamInfo) -> bool:
    """Whether it says what a node says of itself, which ROS knows already, or did once."""
    if info.type() != ContentType.MARKERS:
        return False
    name = info.name()
    return name.startswith(f"{NODE}-") and info.source_id().endswith(name)


def _wanted(query: str) -> Predicate:
    return of_user(query) if query else EVERYTHING


def _asks_for_ros(predicate: Predicate) -> bool:
    return _ROS_BLOCK in predicate


def _resolver(predicate: Predicate) -> pylsl.ContinuousResolver:
    """Look for what a predicate names, and for the counts of losses of all agents."""
    served = predicate if _asks_for_ros(predicate) else all_of(predicate, none_of(FROM_ROS))
    counters = equals("type", ContentType.COUNTERS)
    return pylsl.ContinuousResolver(pred=any_of(served, counters), forget_after=FORGET_AFTER_S)
