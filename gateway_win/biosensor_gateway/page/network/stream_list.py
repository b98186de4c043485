"""Lists the streams of the network, and opens and closes their inlets."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from itertools import count
from typing import Any, NamedTuple, cast

import pylsl
from pylsl import util

from biosensor_common.errors import SpecError
from biosensor_common.lsl.header import read_core
from biosensor_common.lsl.network import SenderNumbers, by_start
from biosensor_common.quantities import ContentType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.stream_header import CoreFields
from biosensor_gateway.page.network.network_stream import (
    CLOCK_WITHIN_S,
    MAX_COUNTERS,
    UNSEEN_S,
    NetworkStream,
    Receiver,
    claim_of,
)


def is_counters(stream: NetworkStream) -> bool:
    """Whether this is the stream of counters of one of our agents."""
    return stream.is_ours and stream.core.content_type == ContentType.COUNTERS


class Counted(NamedTuple):
    """Counters that an agent reports of one of its streams."""

    # Number of samples that never reached the agent; None if it does not report it.
    lost: int | None
    refused: tuple[str, ...]  # What is currently not passed on unchanged, one sentence each.
    away: str = ""  # State of its device while that does not send; else empty.


def counted_by_source(streams: Iterable[NetworkStream], refusals: Refusals) -> dict[str, Counted]:
    """Return the counters that agents report of their streams, by source_id."""
    found: dict[str, Counted] = {}
    for stream in streams:
        # Replayed counters are outdated.
        if is_counters(stream) and not (stream.header and stream.header.replay):
            found.update(_counted(stream, refusals))
    return found


def _counted(stream: NetworkStream, refusals: Refusals) -> dict[str, Counted]:
    text, about = stream.received.raw, stream.core.name
    try:
        counted: object = json.loads(text[:MAX_COUNTERS]) if text else {}
    except (ValueError, RecursionError) as error:
        refusals.refuse(Refusal.NO_COUNTS, about=about, why=error)
        return {}
    if not isinstance(counted, Mapping):
        refusals.refuse(Refusal.NO_COUNTS, about=about, why="they are not an object")
        return {}
    entries = cast("Mapping[str, Any]", counted).items()
    return {
        source: _entry(cast("Mapping[str, Any]", entry))
        for source, entry in entries
        if isinstance(entry, Mapping)
    }


def _entry(entry: Mapping[str, Any]) -> Counted:
    lost, refused = entry.get("lost"), entry.get("refused")
    sentences = cast("list[object]", refused) if isinstance(refused, list) else []
    away = entry.get("away")
    return Counted(
        lost if isinstance(lost, int) else None,
        tuple(map(str, sentences)),
        away if isinstance(away, str) else "",
    )


MAX_STREAMS = 400
FORGET_S = 300.0
# A resolver reports an outlet that has died for another 5 s.
_BOTH_ALIVE_S = 7.0


class StreamList:
    """All streams of the last minutes, by their numbers."""

    def __init__(self) -> None:
        self.streams: dict[int, NetworkStream] = {}
        self.refusals = Refusals()
        self._refused: dict[str, str] = {}
        self._left_out = 0
        self._numbers = count(1)
        self._waiting: dict[str, float] = {}
        self._numbers_of_senders = SenderNumbers()

    def update(self, infos: Iterable[pylsl.StreamInfo], now: float) -> list[Receiver]:
        """Update the list from a resolver; return the receivers that are to be closed.

        Parameters
        ----------
        infos
            Without descriptions.
        now
            Local LSL time.
        """
        # In the order of their start, as the node sorts them, and not in the order of discovery.
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
            twin = Refusal.EITHER_SENDER.message()
            number = self._namesake(info, now)
            self._add(info, core, now, number, note=twin if before or beside else "")
        return None  # nothing is dropped: it is listed, or waits for the end of another one

    def _namesake(self, info: pylsl.StreamInfo, now: float) -> int:
        """Return a sender's number among those with the same claim, without our own streams."""
        claim = claim_of(read_core(info))
        live = {
            each.uid
            for each in self.streams.values()
            if not (each.is_ours or each.is_gone(now)) and each.claim == claim
        }
        return self._numbers_of_senders.number(info, live)

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
        """Make room by removing the stream that has been gone the longest."""
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


MAX_INLETS = 64
"""Limit of inlets, each of which costs its sender as much as another recorder."""
LINGER_S = 5.0
"""How long an inlet stays open unused: a person who scrolls comes back, and opening is slow."""
_RETRY_S = 2.0
_UNSEEN_S = 2.0
# Only pulling samples detects that an outlet has ended.
_SETTLED_S = CLOCK_WITHIN_S + 1.0


class Inlets:
    """Opens and closes receivers."""

    def __init__(self, close: Callable[[Receiver], object], pool: Executor) -> None:
        # Number of streams that browsers show and that are not received, because of the limit.
        self.refused = 0
        self._close, self._pool = close, pool
        self._wanted_s: dict[NetworkStream, float] = {}

    def update(
        self, streams: Mapping[int, NetworkStream], numbers: Iterable[int], now: float
    ) -> None:
        """Receive the streams with these numbers, and the counters of their agents."""
        wanted = [streams[number] for number in numbers if number in streams]
        if any(stream.is_ours for stream in wanted):
            wanted += [stream for stream in streams.values() if is_counters(stream)]
        self._wanted_s.update(dict.fromkeys(wanted, now))
        self._close_unwanted(streams, now)
        self.refused = 0
        open_now = sum(stream.receiver is not None for stream in streams.values())
        for stream in dict.fromkeys(wanted):
            if stream.receiver is None and not self._has_to_wait(stream, now):
                if open_now < MAX_INLETS:
                    open_now += 1
                    self._open(stream)
                else:
                    self.refused += 1
            elif stream.receiver is not None and stream.receiver.age_s > _SETTLED_S:
                stream.lost_s = None

    def drop(self, stream: NetworkStream, now: float, error: RuntimeError) -> None:
        """Note that a stream is lost, or that liblsl cannot open it."""
        if not isinstance(error, util.LostError | util.TimeoutError):
            stream.note = f"LSL cannot open it ({error})"
        stream.lost_s = now
        if stream.receiver is not None:
            self._close(stream.receiver)
        stream.receiver = None

    def _close_unwanted(self, streams: Mapping[int, NetworkStream], now: float) -> None:
        for stream, wanted_s in list(self._wanted_s.items()):
            if now - wanted_s > LINGER_S or stream.number not in streams:
                del self._wanted_s[stream]
                if stream.receiver is not None:
                    self._close(stream.receiver)
                    stream.receiver = None

    def _has_to_wait(self, stream: NetworkStream, now: float) -> bool:
        """Whether a stream must not be opened yet: it is gone, or was lost a moment ago."""
        is_lost = stream.lost_s is not None and now - stream.lost_s < _RETRY_S
        is_unseen = now - stream.seen_s > _UNSEEN_S
        return stream.header is None or is_lost or is_unseen

    def _open(self, stream: NetworkStream) -> None:
        stream.received.begin(stream.core, is_ours=stream.is_ours)
        stream.receiver = Receiver(stream.info, stream.core, self._pool)
