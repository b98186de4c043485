"""Opens second inlets for streams that the resolver sees again but that send nothing.

After a network cut a connection continues with its backlog, unless the cut was so long that TCP's
next retry is far away; then only a new connection helps, and the backlog is lost. A sender that
only got no processor time looks the same, but continues where it stopped. So both inlets stay
open, and the first one that receives samples wins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import monotonic
from typing import NamedTuple

import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.refusals import Refusals
from lsl_to_ros.lsl.inlets import Inlet, InletState

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
        """Open and close second inlets; return the swaps with those that have won.

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
        """Close all."""
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
            f"{inlet.core}: seen again after a cut, but not heard; a second connection is tried"
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
