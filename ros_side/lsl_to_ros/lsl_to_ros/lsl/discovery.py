"""Finds streams and opens an inlet for each of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, filterfalse
from time import monotonic
from typing import NamedTuple

import pylsl

from biosensor_common import process_limits
from biosensor_common.errors import SpecError
from biosensor_common.lsl.network import Living, Network, SenderNumbers
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
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.lsl.inlets import FROM_ROS, Inlet, InletState, about

# After a cut, TCP retries after 6.3 s or 12.7 s, with its backlog; the later retries are too
# far apart to wait for them once the stream is seen again.
PATIENCE_S = 14.0
SEEN_AGAIN_S = 4.0
# A sender that continues may serve the new connection first.
GRACE_S = 1.0


class Swap(NamedTuple):
    """An inlet that is closed, and the one that replaces it."""

    old: Inlet
    new: Inlet


@dataclass(slots=True)
class _Duplicate:
    inlet: Inlet
    opened_s: float = field(default_factory=monotonic)
    filled_s: float | None = None

    @property
    def has_won(self) -> bool:
        """Whether it has received samples for a while."""
        if self.filled_s is None and self.inlet.waiting:
            self.filled_s = monotonic()
        return self.filled_s is not None and monotonic() - self.filled_s > GRACE_S

    def is_behind(self, old: Inlet) -> bool:
        """Whether it is useless: it has failed, or the other inlet received samples meanwhile."""
        is_well = self.inlet.state in (InletState.OPENING, InletState.READY)
        return not is_well or old.heard_s > self.opened_s


class Duplicates:
    """Manages the second inlets.

    Parameters
    ----------
    warn
        Called with a sentence when a second inlet is opened.
    refusals
        Passed on to the inlets.
    """

    def __init__(self, warn: Callable[[str], None], refusals: Refusals) -> None:
        self._warn, self._refusals = warn, refusals
        self._unseen: set[str] = set()
        self._seen_again: dict[str, float] = {}
        self._duplicates: dict[str, _Duplicate] = {}

    def look(
        self, inlets: Mapping[str, Inlet], found: Mapping[str, pylsl.StreamInfo]
    ) -> list[Swap]:
        """Open and close second inlets; return the swaps in which the second one takes over.

        Parameters
        ----------
        inlets, found
            The present inlets, and the resolver's streams, by uid.
        """
        self._note_seen(inlets, found)
        for inlet in self._stranded(inlets):
            if inlet.uid not in self._duplicates:
                self._open(found[inlet.uid], inlet.number)
        return [swap for uid in list(self._duplicates) if (swap := self._settle(inlets[uid]))]

    def successor(self, ended: Inlet) -> Inlet | None:
        """Return the second inlet of a stream whose first one has ended, if there is one."""
        duplicate = self._duplicates.get(ended.uid)
        if duplicate is None:
            return None  # nothing is dropped: it has none
        if duplicate.is_behind(ended):
            self.close(ended.uid)
            return None  # nothing is dropped: the first inlet was heard
        return self._swapped(ended).new

    def close(self, uid: str) -> None:
        """Close the second inlet of a stream, if there is one."""
        duplicate = self._duplicates.pop(uid, None)
        if duplicate is not None:
            duplicate.inlet.stop()

    def stop(self) -> None:
        """Close all second inlets."""
        for uid in list(self._duplicates):
            self.close(uid)

    def _note_seen(
        self, inlets: Mapping[str, Inlet], found: Mapping[str, pylsl.StreamInfo]
    ) -> None:
        self._unseen.intersection_update(inlets)
        for uid in self._seen_again.keys() - inlets.keys():
            del self._seen_again[uid]
        for uid in inlets:
            if uid not in found:
                self._unseen.add(uid)
                self._seen_again.pop(uid, None)
            elif uid in self._unseen:
                self._unseen.discard(uid)
                self._seen_again[uid] = monotonic()

    def _stranded(self, inlets: Mapping[str, Inlet]) -> list[Inlet]:
        """Return the inlets whose stream is seen again but sends nothing."""
        now = monotonic()
        silent = [
            inlet
            for uid, inlet in inlets.items()
            if now - self._seen_again.get(uid, now) > SEEN_AGAIN_S
            and now - inlet.heard_s > PATIENCE_S
        ]
        # An irregular stream may have nothing to send, so its computer's other streams decide.
        hosts = {inlet.core.hostname for inlet in silent if inlet.core.rate > 0 < inlet.heard_s}
        return [inlet for inlet in silent if inlet.core.hostname in hosts]

    def _open(self, info: pylsl.StreamInfo, number: int) -> None:
        try:
            inlet = Inlet(info, self._refusals, number)
        except SpecError:
            # nothing is dropped: it was fit to be used before, and the first inlet is still there
            return
        self._duplicates[inlet.uid] = _Duplicate(inlet)
        # nothing is dropped: a second connection is tried
        self._warn(
            f"{inlet.core}: seen again after an interruption, but nothing received; trying a "
            "second connection"
        )

    def _settle(self, old: Inlet) -> Swap | None:
        duplicate = self._duplicates[old.uid]
        if duplicate.is_behind(old):
            self.close(old.uid)
        elif duplicate.has_won and old.give_up(duplicate.opened_s):
            return self._swapped(old)
        return None  # nothing is dropped: both stay open

    def _swapped(self, old: Inlet) -> Swap:
        self._seen_again.pop(old.uid, None)
        new = self._duplicates.pop(old.uid).inlet
        if old.correction is not None:
            new.take_correction(old.correction)
        return Swap(old, new)


RETRY_S = 0.5
RETRY_FAILED_S = 5.0
STOP_TIMEOUT_S = 1.0
# So long an outlet waits until it is known whether another one that claims to be the same lives.
SETTLED_S = 2.0
_ROS_BLOCK = "desc/ros"


def wanted_by(query: str) -> Predicate:
    """Return the predicate of a user's query; an empty query selects all streams."""
    return of_user(query) if query else EVERYTHING


def asks_for_ros(predicate: Predicate) -> bool:
    """Whether a predicate selects streams made from topics."""
    return _ROS_BLOCK in predicate


def query_of(predicate: Predicate) -> Predicate:
    """Select the streams of a predicate and the counters of all agents."""
    served = predicate if asks_for_ros(predicate) else all_of(predicate, none_of(FROM_ROS))
    return any_of(served, equals("type", ContentType.COUNTERS))


class FileRoom:
    """Stores which streams exceed the limit of open files, until they fit or are gone."""

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._names: dict[str, tuple[str, str]] = {}

    @property
    def crowded_out(self) -> list[str]:
        """Names of the streams that are left out."""
        return [name for name, _ in self._names.values()]

    def has_room(self, info: pylsl.StreamInfo, opening: int) -> bool:
        """Whether another stream may be opened besides those that are being opened."""
        if process_limits.has_room((1 + opening) * process_limits.INLET):
            self._forget(info.uid())
            return True
        if not opening:
            self._names[info.uid()] = info.name(), about(info)
            why = process_limits.no_room()
            self._refusals.refuse(Refusal.NO_FILES, about=about(info), why=why)
        return False

    def forget_all_but(self, known: Collection[str]) -> None:
        """Forget streams that are gone; *known* are the uids of the present ones."""
        for uid in [uid for uid in self._names if uid not in known]:
            self._forget(uid)

    def _forget(self, uid: str) -> None:
        if uid in self._names:
            self._refusals.over(Refusal.NO_FILES, self._names.pop(uid)[1])


class Discovery:
    """Keeps one inlet for each stream on the network that the predicate selects.

    The agents' counters are always received, because they cover all streams. Streams that
    ``ros_to_lsl`` makes from topics are left out, unless the predicate itself names
    ``desc/ros``: they would loop back into ROS.

    An inlet is closed when its stream is lost or comes back under the same
    source_id, never because the resolver stopped seeing it: after a network cut it
    continues by itself, with its backlog. Where it does not within some seconds after the
    resolver sees the stream again, a second inlet is opened, and the first that
    brings something stays (:class:`~lsl_to_ros.lsl.duplicates.Duplicates`).

    Several live senders of other programs with the same identity all get an inlet, and their
    streams are numbered. Of our own streams the latest one is taken: a device exists once.
    """

    def __init__(self, warn: Callable[[str], None], predicate: str = "") -> None:
        self.refusals = Refusals(warn)  # Streams that are left out or may be confused.
        self._predicate = wanted_by(predicate)
        self._network = Network(query_of(self._predicate))
        self._living = Living(query_of(self._predicate))
        self._inlets: dict[str, Inlet] = {}
        self._announced: set[str] = set()
        self._order: dict[str, int] = {}
        self._numbers = count()
        self._not_before: dict[str, float] = {}
        self._left_out: set[str] = set()
        self._alive: set[str] = set()
        self._seen_s: dict[str, float] = {}
        self._refused: dict[str, str] = {}
        self._numbers_of_senders = SenderNumbers()
        self._twins: dict[str, pylsl.StreamInfo] = {}
        self._room = FileRoom(self.refusals)
        self._duplicates = Duplicates(warn, self.refusals)

    @property
    def inlets(self) -> list[Inlet]:
        """All present inlets."""
        return list(self._inlets.values())

    @property
    def refused(self) -> int:
        """Number of present streams that cannot be used."""
        return len(self._refused)

    @property
    def crowded_out(self) -> Collection[str]:
        """Names of the present streams beyond the limit of open files of this process."""
        return self._room.crowded_out

    def twins(self, inlet: Inlet) -> list[str]:
        """Return the computers of live senders that are left out as duplicates of this stream."""
        found = [info for info in self._twins.values() if inlet.continues_as(info)]
        return sorted(info.hostname() for info in found)

    def senders(self, inlet: Inlet) -> list[str]:
        """Return the computers of all served senders with this stream's identity."""
        others = _continued_as(inlet.info, self.inlets)
        return sorted(other.info.hostname() for other in others) if len(others) > 1 else []

    def set_predicate(self, predicate: str) -> None:
        """Change the selection of streams.

        Parameters
        ----------
        predicate
            LSL query; empty for all streams.

        Raises
        ------
        SpecError
            ``INVALID``, if brackets or quotes in it are unbalanced.
        """
        wanted = wanted_by(predicate)
        if wanted != self._predicate:
            self._predicate = wanted
            self._network = Network(query_of(wanted))
            self._living = Living(query_of(wanted))

    def update(self) -> tuple[list[Inlet], list[Inlet]]:
        """Open inlets for new streams; return those that became ready, and those that ended."""
        gone = self._ended()
        streams = filterfalse(_is_of_a_node, self._network.streams())
        found = {info.uid(): info for info in streams}
        swaps = self._swaps(gone, found)
        gone += [swap.old for swap in swaps if swap.old not in gone]
        for uid, info in found.items():
            self._order.setdefault(uid, next(self._numbers))
            if self._is_new(uid):
                gone += self._admit(info, found)
        self._close(gone)
        self._inlets.update((swap.new.uid, swap.new) for swap in swaps)
        self._forget_all_but(found)
        self._tell_of_twins(found)
        ready = [
            inlet
            for inlet in self.inlets
            if inlet.state is InletState.READY and inlet.uid not in self._announced
        ]
        for inlet in ready:
            inlet.is_served = self._is_to_be_served(inlet)
            self._announced.add(inlet.uid)
        return ready, gone

    def stop(self) -> None:
        """End all inlets."""
        self._duplicates.stop()
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
                self._refused[inlet.uid] = inlet.about
                ended.append(inlet)
            elif wait is not None or self._is_served_otherwise(inlet):
                ended.append(inlet)
        return ended

    def _swaps(self, ended: list[Inlet], found: Mapping[str, pylsl.StreamInfo]) -> list[Swap]:
        """Return the replacements of inlets that have ended or are closed."""
        followed = [Swap(old, new) for old in ended if (new := self._duplicates.successor(old))]
        present = {uid: inlet for uid, inlet in self._inlets.items() if inlet not in ended}
        return followed + self._duplicates.look(present, found)

    def _is_served_otherwise(self, inlet: Inlet) -> bool:
        """Whether the predicate has changed for a stream since it was announced."""
        is_announced = inlet.uid in self._announced
        return is_announced and self._is_to_be_served(inlet) is not inlet.is_served

    def _is_to_be_served(self, inlet: Inlet) -> bool:
        is_meant = not inlet.is_from_ros or asks_for_ros(self._predicate)
        return is_meant and inlet.matches(self._predicate)

    def _admit(self, info: pylsl.StreamInfo, found: Collection[str]) -> list[Inlet]:
        """Open an inlet once the stream may be served; return the inlets that it replaces."""
        before = _continued_as(info, self.inlets)
        waited_s = monotonic() - self._seen_s.setdefault(info.uid(), monotonic())
        is_opening = any(other.state is InletState.OPENING for other in before)
        live = [other for other in before if _is_of_another(other) and other.uid in found]
        if (is_opening or live) and waited_s < SETTLED_S:
            # nothing is dropped: it is known soon whether it follows one that has ended
            return []
        if self._is_superseded(info) and (len(live) < len(before) or not self._is_alive(info)):
            # nothing is dropped: it has ended, or `_tell_of_twins` reports it
            return []
        return self._open(info, live, [other for other in before if other not in live])

    def _is_alive(self, info: pylsl.StreamInfo) -> bool:
        """Whether an outlet is alive although another one seemed to replace it."""
        return info.uid() in self._alive

    def _open(
        self, info: pylsl.StreamInfo, beside: Sequence[Inlet], replaced: list[Inlet]
    ) -> list[Inlet]:
        if not self._has_room(info):
            # nothing is dropped: `_has_room` reports it
            return []
        number = self._numbers_of_senders.number(info, {other.uid for other in beside})
        try:
            inlet = Inlet(info, self.refusals, number)
        except SpecError as error:
            self._refused[info.uid()] = about(info)
            self.refusals.refuse(Refusal.UNUSABLE, about=about(info), why=error)
            return []
        self._inlets[inlet.uid] = inlet
        self._left_out.discard(inlet.uid)
        return replaced

    def _has_room(self, info: pylsl.StreamInfo) -> bool:
        """Whether another inlet may be opened besides those that are open or being opened."""
        opening = sum(each.state is InletState.OPENING for each in self.inlets)
        has_room = self._room.has_room(info, opening)
        if not has_room:
            # Inlets that are being opened have only some of their files; it is tried again later.
            self._not_before[info.uid()] = monotonic() + (RETRY_S if opening else RETRY_FAILED_S)
        return has_room

    def _is_new(self, uid: str) -> bool:
        if uid in self._inlets or uid in self._refused:
            return False
        return monotonic() >= self._not_before.get(uid, 0.0)

    def _is_superseded(self, info: pylsl.StreamInfo) -> bool:
        """Whether an outlet that appeared later replaces this one.

        Either the earlier one has ended and is still reported, or both are alive with one
        source_id; connecting to them alternately would then lose samples of both.
        """
        uid = info.uid()
        later = [inlet for inlet in self.inlets if self._order[inlet.uid] > self._order[uid]]
        if not _continued_as(info, later):
            return False
        self._left_out.add(uid)
        return True

    def _tell_of_twins(self, found: Mapping[str, pylsl.StreamInfo]) -> None:
        """Report live outlets that are left out because a later one has the same identity."""
        self._alive = self._living.among(self._left_out & found.keys(), monotonic())
        for uid in self._left_out & self._alive:
            if uid not in self._twins:
                self._twins[uid] = found[uid]
                host = found[uid].hostname()
                self.refusals.refuse(Refusal.SAME_SOURCE, about=about(found[uid]), hosts=host)

    def _close(self, gone: list[Inlet]) -> None:
        for inlet in gone:
            inlet.stop()
            self._duplicates.close(inlet.uid)
            self._inlets.pop(inlet.uid, None)
            self._announced.discard(inlet.uid)

    def _forget_all_but(self, found: Mapping[str, pylsl.StreamInfo]) -> None:
        known = found.keys() | self._inlets.keys()
        self._left_out &= known
        for record in (self._not_before, self._order, self._seen_s):
            for uid in record.keys() - known:
                del record[uid]
        self._room.forget_all_but(known)
        for uid in self._twins.keys() - (found.keys() & self._left_out):
            self.refusals.over(Refusal.SAME_SOURCE, about(self._twins.pop(uid)))
        for uid in self._refused.keys() - found.keys():
            self.refusals.over(Refusal.UNUSABLE, self._refused.pop(uid))


def _is_of_a_node(info: pylsl.StreamInfo) -> bool:
    """Whether it is a node's own stream, live or replayed; its content is already in ROS."""
    if info.type() != ContentType.MARKERS:
        return False
    name = info.name()
    return name.startswith(f"{NODE}-") and info.source_id().endswith(name)


def _is_of_another(inlet: Inlet) -> bool:
    """Whether an inlet's stream comes from another program and is not lost."""
    is_foreign = inlet.header is None or inlet.header.foreign
    return inlet.state is InletState.READY and is_foreign


def _continued_as(info: pylsl.StreamInfo, inlets: Iterable[Inlet]) -> list[Inlet]:
    """Return the inlets of which *info* is an announcement."""
    # Asked for each stream about all others: liblsl would have to copy its source_id each time.
    source_id = info.source_id()
    alike = [inlet for inlet in inlets if inlet.source_id == source_id]
    return [inlet for inlet in alike if inlet.continues_as(info)]
