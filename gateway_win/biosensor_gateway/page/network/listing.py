"""Keeps the list of streams: who is new, who has come back, who is gone."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count

import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.lsl.header import read_core
from biosensor_common.lsl.namesakes import Namesakes, by_start
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.stream_header import CoreFields
from biosensor_gateway.page.network.receiver import Receiver
from biosensor_gateway.page.network.stream import UNSEEN_S, NetworkStream, claim_of

MAX_STREAMS = 400
FORGET_S = 300.0
# A resolver reports an outlet that has died for another 5 s.
_BOTH_ALIVE_S = 7.0


class Listing:
    """All streams that were seen in the last minutes, by their numbers.

    Attributes
    ----------
    refusals
        What is not listed, and why.
    """

    def __init__(self) -> None:
        self.streams: dict[int, NetworkStream] = {}
        self.refusals = Refusals()
        self._refused: dict[str, str] = {}
        self._left_out = 0
        self._numbers = count(1)
        self._waiting: dict[str, float] = {}
        self._namesakes = Namesakes()

    def update(self, infos: Iterable[pylsl.StreamInfo], now: float) -> list[Receiver]:
        """Take in what a resolver reports; return the inlets that are of no more use.

        Parameters
        ----------
        infos
            Without descriptions.
        now
            Local LSL time.
        """
        # As a node does, whichever was found first.
        found = {info.uid(): info for info in sorted(infos, key=by_start)}
        known = {stream.uid for stream in self.streams.values()}
        for stream in self.streams.values():
            if stream.uid in found:
                stream.seen_s = now
        self._forget(found, now)
        self._left_out = 0
        closing = [
            self._take(info, now) for uid, info in found.items()
            if uid not in known and uid not in self._refused
        ]  # fmt: skip
        hold = self.refusals.hold
        hold(Refusal.NOT_LISTED, bool(self._left_out), self._left_out, most=MAX_STREAMS)
        return [each for each in closing if each is not None]

    def _take(self, info: pylsl.StreamInfo, now: float) -> Receiver | None:
        try:
            core = read_core(info)
        except SpecError as error:
            self._refused[info.uid()] = about = info.name()
            self.refusals.refuse(Refusal.UNUSABLE, about=about, why=error)
            return None
        before = [each for each in self.streams.values() if each.continues_as(core)]
        away = [each for each in before if each.lost_s is not None or _is_unseen(each, now)]
        if away:
            self._waiting.pop(info.uid(), None)
            away[0].namesake = self._namesake(info, now)
            return away[0].follow(info, core, now)
        since = self._waiting.setdefault(info.uid(), now)
        claim = claim_of(core)
        beside = any(not each.is_ours and each.claim == claim for each in self.streams.values())
        if not (before or beside) or now - since > _BOTH_ALIVE_S:
            twin = Refusal.EITHER_SENDER.told()
            number = self._namesake(info, now)
            self._add(info, core, now, number, note=twin if before or beside else "")
        return None  # nothing is dropped: it is listed, or waits for the end of another one

    def _namesake(self, info: pylsl.StreamInfo, now: float) -> int:
        """Return a sender's number; of ours a node takes one only, which is no other stream."""
        claim = claim_of(read_core(info))
        live = {
            each.uid
            for each in self.streams.values()
            if not (each.is_ours or each.is_gone(now)) and each.claim == claim
        }
        return self._namesakes.number(info, live)

    def _add(
        self, info: pylsl.StreamInfo, core: CoreFields, now: float, namesake: int, note: str
    ) -> None:
        if len(self.streams) >= MAX_STREAMS and not self._drop_one(now):
            self._left_out += 1
            self.refusals.refuse(Refusal.NOT_LISTED, self._left_out, most=MAX_STREAMS)
            return
        self._waiting.pop(info.uid(), None)
        number = next(self._numbers)
        self.streams[number] = NetworkStream(
            number, info, core, info.uid(), now, namesake=namesake, note=note
        )

    def _drop_one(self, now: float) -> bool:
        """Make room by forgetting what has been gone the longest."""
        gone = [each for each in self.streams.values() if each.is_gone(now)]
        if gone:
            del self.streams[min(gone, key=lambda each: each.seen_s).number]
        return bool(gone)

    def _forget(self, found: dict[str, pylsl.StreamInfo], now: float) -> None:
        for number, stream in list(self.streams.items()):
            if now - stream.seen_s > FORGET_S and stream.is_gone(now):
                del self.streams[number]
        for uid in self._waiting.keys() - found.keys():
            del self._waiting[uid]
        for uid in self._refused.keys() - found.keys():
            self.refusals.over(Refusal.UNUSABLE, self._refused.pop(uid))


def _is_unseen(stream: NetworkStream, now: float) -> bool:
    return now - stream.seen_s > UNSEEN_S
