"""Receives raw streams from LSL, and sends their features as streams."""

from __future__ import annotations

import math
import socket
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Container, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import pylsl

from biosensor_common.errors import SpecError, TransportError
from biosensor_common.lsl.inlet import Connection, buffer_length, fetch_description
from biosensor_common.lsl.network import Living, Network
from biosensor_common.lsl.outlet import LslOutlet
from biosensor_common.lsl.predicates import any_of, equals
from biosensor_common.lsl.sender_clocks import SenderClocks
from biosensor_common.lsl_header import read_header
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.features.outputs import READ_SPELLINGS, feature_streams
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import (
    FeatureError,
    Source,
    Taken,
    choose,
    is_feature,
    judge,
    left_out,
    stream_info,
)
from biosensor_gateway.features.witnesses import Witnesses

_OPEN_S = 5.0
_MOST_HELD = 4096
"""Number of event lists that may wait for the first clock correction."""
_BUFFER_S = 360
_MOST_SAMPLES = 8192
Remark = tuple[Refusal, int, str]
"""What was left out, how many samples, and why."""


class Link:
    """The inlet of one outlet of a source, and the computation of its features.

    Parameters
    ----------
    info
        Of the outlet, from a resolver.
    asking
        Threads that wait for the sender.
    witnesses
        Of all devices.
    """

    def __init__(
        self,
        source: Source,
        info: pylsl.StreamInfo,
        asking: ThreadPoolExecutor,
        witnesses: Witnesses,
    ) -> None:
        self.uid, self._name = info.uid(), source.name
        length = buffer_length(source.header.rate, _BUFFER_S)
        self.connection = Connection(info, asking, _OPEN_S, length)
        # Whether the sender is this computer, whose stamps need no clock correction.
        self.is_here = info.hostname() == socket.gethostname()
        self.has_received = False
        self._computer = source.new_computer(witnesses)
        self._told = self._gone = self._told_gone = self._told_values = 0
        self._told_rate = ""
        # nothing is dropped: what is given up is counted in `read` and told by `remarks`
        self._held: deque[Sequence[Event]] = deque(maxlen=_MOST_HELD)

    def read(self) -> list[tuple[Sequence[Event], float]]:
        """Receive the samples that have arrived, without blocking.

        Returns
        -------
        list
            Events whose time is known, each with the clock correction to add to its stamps, in
            seconds.

        Raises
        ------
        RuntimeError
            If the outlet has ended, or does not answer.
        """
        inlet = self.connection.inlet
        if inlet is None:
            return []  # nothing is dropped: it is being opened
        pulled: tuple[Any, Any] = inlet.pull_chunk(0.0, _MOST_SAMPLES)
        samples, stamps = pulled
        if stamps:
            self.has_received = True
            events = self._computer.take(
                np.array(stamps, np.float64), np.array(samples, np.float64)
            )
            if events:
                self._gone += len(self._held) == _MOST_HELD
                self._held.append(events)
        # Without an answer, the last correction is still good: clocks drift slowly.
        seconds = 0.0 if self.is_here else self.connection.correction
        known: list[tuple[Sequence[Event], float]] = []
        while self._held and seconds is not None:
            known.append((self._held.popleft(), seconds))
        return known

    def remarks(self) -> list[Remark]:
        """Return news since the last call; wrong stamps only when their number has doubled."""
        found: list[Remark] = []
        if (why := self._computer.rate_remark) != self._told_rate:
            self._told_rate = why
            found.append((Refusal.WRONG_RATE, 1, why))
        if self._computer.left_out > self._told:
            new = self._computer.left_out - self._told // 2
            self._told = 2 * self._computer.left_out
            why = self._computer.remark().removeprefix(f"{self._name}: ")
            found.append((Refusal.STAMPS_LEFT_OUT, new, why))
        if new := self._computer.without_value - self._told_values:
            self._told_values += new
            found.append((Refusal.NO_FINITE_VALUE, new, ""))
        if new := self._gone - self._told_gone:
            self._told_gone += new
            found.append((Refusal.UNSTAMPED, new, ""))
        return found


READ_S = 0.02
LOOK_EVERY = 25
"""Number of readings between two looks at the network."""
SETTLED_S = 3.0
"""How long to wait for all streams of a device; later ones get the features that are left."""
SILENT_S = 20.0
"""For how long a source may send nothing while its device sends, before the next one is taken."""
DUPLICATE_S = 7.0
"""Age at which a second outlet is a duplicate; an ended one is found for some seconds more."""
_DESCRIPTION_S = 3.0
_ASKING = 4
"""Number of threads that wait for other computers, so that receiving never waits."""


class Listener(Protocol):
    """Is notified of sources and refusals."""

    def found(self, source: Source) -> None:
        """Note that features of a stream are computed."""
        ...

    def refused(self, sentence: str) -> None:
        """Note that features of a stream, or of some of its samples, are not computed."""
        ...


class Sender:
    """The outlets of one source."""

    def __init__(self, source: Source) -> None:
        infos = {each.name: stream_info(source, each) for each in source.features}
        self.source_ids = [each.source_id() for each in infos.values()]
        self._outlets = {name: LslOutlet(info) for name, info in infos.items()}

    def send(self, events: Sequence[Event], correction_s: float) -> None:
        """Push events, with their stamps converted to this computer's clock."""
        for name, outlet in self._outlets.items():
            # nothing is dropped: each feature has its turn
            own = [each for each in events if each.feature == name]
            if own:
                values = np.array([each.values for each in own], np.float32)
                outlet.push_chunk(values, [each.stamp + correction_s for each in own])


class _Seen:
    def __init__(self, source: Source, info: pylsl.StreamInfo, since_s: float) -> None:
        self.source, self.info, self.since_s = source, info, since_s


class _Stage:
    """Receives one source, over successive outlets, and sends its features."""

    def __init__(self, seen: _Seen, asking: ThreadPoolExecutor, witnesses: Witnesses) -> None:
        self.source, self.info, self.since_s = seen.source, seen.info, seen.since_s
        self._witnesses = witnesses
        self.is_lost = self.has_rival = False
        self._sender: Sender | None = None
        self._asking = asking
        self._link = Link(seen.source, seen.info, asking, witnesses)

    @property
    def uid(self) -> str:
        """Uid of the newest outlet."""
        return self._link.uid

    @property
    def has_begun(self) -> bool:
        """Whether its outlets are open."""
        return self._sender is not None

    @property
    def sent_ids(self) -> Sequence[str]:
        """The source_ids of its outlets."""
        return () if self._sender is None else self._sender.source_ids

    @property
    def is_silent(self) -> bool:
        """Whether its present outlet has not sent a sample yet."""
        return not self._link.has_received

    def follow(self, info: pylsl.StreamInfo) -> None:
        """Continue with another outlet that has the same header."""
        self.close()
        self.info = info
        self._link = Link(self.source, info, self._asking, self._witnesses)
        self.is_lost = False

    @property
    def connection(self) -> Connection | None:
        """The connection, if its sender is another computer whose clock must be measured."""
        return None if self.is_lost or self._link.is_here else self._link.connection

    def read(self) -> None:
        """Receive samples, and send the features that are ready.

        Raises
        ------
        RuntimeError
            See `Link`.
        TransportError
            If no more files may be opened.
        """
        if self.is_lost:
            return  # nothing is dropped: its outlet has ended
        known = self._link.read()
        if self._link.has_received or (self._link.connection.is_open and not self.has_rival):
            # The outlets are opened only now, so that there are none for a stream that has ended,
            # or that never sends while another one does: which one depends on the model.
            self._sender = self._sender or Sender(self.source)
            for events, seconds in known:
                self._sender.send(events, seconds)

    def remarks(self) -> list[Remark]:
        """Return what was noticed on the link."""
        return self._link.remarks()

    def close(self) -> None:
        """Close the inlet."""
        self._link.connection.close()


class Live:
    """Computes features of all streams on the network, until stopped.

    One thread receives, computes and sends. Other threads wait for descriptions and clocks of other
    computers, so that a sender that hangs blocks no other stream.

    Parameters
    ----------
    report
        Called with all refusals about twice a second, in a thread that may block.
    """

    def __init__(
        self,
        listener: Listener,
        clock: Callable[[], float] = pylsl.local_clock,
        report: Callable[[Refusals], None] | None = None,
    ) -> None:
        self._listener, self._clock, self._report = listener, clock, report
        self.refusals = Refusals(listener.refused, clock=clock)
        self._refuse = self.refusals.refuse
        self._reported: Future[None] | None = None
        # Key of each stream, which survives restarts, by uid.
        self._known: dict[str, str] = {}
        self._waiting: list[_Seen] = []
        # Streams with features that a better stream of their device provides now.
        self._spare: dict[str, _Seen] = {}
        self._told_spare: set[str] = set()
        self._taken: Taken = set()
        self._stages: dict[str, _Stage] = {}
        # When the first sample of each device came.
        self._sending: dict[DeviceIdentity, float] = {}
        self._witnesses: Witnesses = {}
        self._asking = ThreadPoolExecutor(_ASKING, thread_name_prefix="asking")
        self._described: list[tuple[pylsl.StreamInfo, Future[str]]] = []
        self._duplicates: dict[str, float] = {}
        # Connections whose clocks another thread measures.
        self._measured: list[Connection] = []

    def run(self, stopping: threading.Event) -> None:
        """Receive and send until *stopping* is set."""
        raw_streams = any_of(*(equals("type", each) for each in READ_SPELLINGS))
        network = Network(raw_streams)
        sent, living = Network(feature_streams()), Living(feature_streams())
        clocks = SenderClocks(lambda: self._measured)
        count = 0
        try:
            while not stopping.wait(READ_S):
                if count % LOOK_EVERY == 0:
                    self.look(network.streams())
                    self.look_for_others(sent.streams(), living)
                    self._report_refusals()
                count += 1
                self.read()
        finally:
            clocks.stop()
            self._asking.shutdown(wait=False, cancel_futures=True)
            for stage in self._stages.values():
                stage.close()

    def _report_refusals(self) -> None:
        """Report the refusals, unless the last report still waits for a slow disk."""
        if self._report is not None and (self._reported is None or self._reported.done()):
            self._reported = self._asking.submit(self._report, self.refusals)

    def look(self, infos: Sequence[pylsl.StreamInfo]) -> None:
        """Process the streams on the network, and start those whose description was received."""
        present = {info.uid() for info in infos}
        pending = {info.uid() for info, _ in self._described}
        pending |= {each.info.uid() for each in self._waiting}
        for uid in self._known.keys() - present - pending:
            del self._known[uid]
            self._spare.pop(uid, None)
        for info in infos:
            if info.uid() not in self._known and not self._is_held(info, present):
                self._known[info.uid()] = _key(info)
                self._described.append((info, self._asking.submit(_description, info)))
        done = [each for each in self._described if each[1].done()]
        self._described = [each for each in self._described if not each[1].done()]
        for info, description in done:
            self._judge(info, description)
        self._replace_silent()
        self._begin()
        connections = (each.connection for each in self._stages.values())
        self._measured = [each for each in connections if each is not None]

    def look_for_others(self, infos: Sequence[pylsl.StreamInfo], living: Living) -> None:
        """Report other programs that send the same features, from all features on the network."""
        senders = defaultdict[str, list[pylsl.StreamInfo]](list)
        for info in infos:
            senders[info.source_id()].append(info)
        by_name = {each.source.name: each.sent_ids for each in self._stages.values()}
        own = {each for ids in by_name.values() for each in ids}
        doubted = [e.uid() for each in own if len(senders[each]) > 1 for e in senders[each]]
        alive = living.among(doubted, self._clock())
        for about, ids in by_name.items():
            both = [[e for e in senders[each] if e.uid() in alive] for each in ids]
            hosts = " and ".join(sorted({e.hostname() for each in both for e in each}))
            is_twice = any(len(each) > 1 for each in both)
            self.refusals.hold(Refusal.FEATURES_TWICE, is_twice, about=about, hosts=hosts)

    def read(self) -> None:
        """Receive samples of all streams, and send the features that are ready."""
        for key, stage in list(self._stages.items()):
            had_begun = stage.has_begun
            try:
                stage.read()
            except RuntimeError:
                # nothing is dropped: the outlet has ended, and is looked for again
                self._lose(key, stage)
            except TransportError as error:
                # No more files may be opened: neither for an inlet nor for outlets.
                self._refuse(Refusal.NO_FEATURES, about=stage.source.name, why=error)
                self._give_up(key)
            if not stage.is_silent:
                self._sending.setdefault(stage.source.identity, self._clock())
            if stage.has_begun and not had_begun and stage.source.features:
                self._listener.found(stage.source)
            for what, count, why in stage.remarks():
                self._refuse(what, count, about=stage.source.name, why=why)

    def _lose(self, key: str, stage: _Stage) -> None:
        """Mark the stream as lost, so that a new outlet of it is searched for."""
        stage.is_lost = True
        self._known = {uid: each for uid, each in self._known.items() if each != key}
        if not stage.has_begun:
            self._give_up(key)

    def _give_up(self, key: str) -> None:
        """Close a stream, so that other streams of the device can provide its features."""
        stage = self._stages.pop(key)
        stage.close()
        self.refusals.over(Refusal.FEATURES_TWICE, stage.source.name)
        identity = stage.source.identity
        features = stage.source.features
        self._taken -= {(identity, each.stream.data_name) for each in features}
        for uid, seen in list(self._spare.items()):
            if seen.source.identity == identity:
                self._waiting.append(self._spare.pop(uid))

    def _replace_silent(self) -> None:
        """Let other streams of the device provide the features of silent sources."""
        now = self._clock()
        for key, stage in list(self._stages.items()):
            sending_s = self._sending.get(stage.source.identity, now)
            if (
                stage.has_rival
                and not stage.has_begun
                and now - max(sending_s, stage.since_s) > SILENT_S
            ):
                self._give_up(key)
                self._spare_for_later(stage.source, stage.info)

    def _spare_for_later(self, source: Source, info: pylsl.StreamInfo) -> None:
        """Store features that another stream of the device provides now."""
        known = self._spare.get(info.uid())
        if known is not None:
            source = replace(source, features=(*known.source.features, *source.features))
        self._spare[info.uid()] = _Seen(source, info, self._clock())

    def _tell_spare(self, source: Source) -> None:
        """Report once which other stream provides the features of another program's stream."""
        owners = (each.source for each in self._stages.values() if not each.is_lost)
        why = left_out(source, source.features, owners)
        if why and why not in self._told_spare:
            self._told_spare.add(why)
            self._refuse(Refusal.NO_FEATURES, about=source.name, why=why)

    def _has_rival(self, source: Source) -> bool:
        """Whether another stream of the device could provide some of the features."""
        wanted = {each.stream.data_name for each in source.features}
        return any(
            each.stream.data_name in wanted
            for seen in self._spare.values()
            if seen.source.identity == source.identity
            for each in seen.source.features
        )

    def _is_held(self, info: pylsl.StreamInfo, present: Container[str]) -> bool:
        """Whether this outlet, or another one of its stream, is received."""
        stage = self._stages.get(_key(info))
        if stage is None or stage.is_lost:
            return False
        if info.uid() == stage.uid:
            return True
        if stage.uid in present:
            self._note_duplicate(info)
            return True
        return False

    def _note_duplicate(self, info: pylsl.StreamInfo) -> None:
        """Report a duplicate outlet once, unless it ends: an ended one is found for a while."""
        since_s = self._duplicates.setdefault(info.uid(), self._clock())
        if self._clock() - since_s > DUPLICATE_S:
            self._duplicates[info.uid()] = math.inf
            why = (
                f"two streams {info.name()!r} share the source_id {info.source_id()!r}; that on "
                f"{info.hostname()} is left out, so give it its own"
            )
            self._refuse(Refusal.NO_FEATURES, about=info.name(), why=why)

    def _judge(self, info: pylsl.StreamInfo, description: Future[str]) -> None:
        try:
            xml = description.result()
        except (TimeoutError, RuntimeError):
            # nothing is dropped: it may have ended; if not, the next look finds it again
            self._known.pop(info.uid(), None)
            return  # nothing is dropped: as above
        if is_feature(xml):
            return  # nothing is dropped: features of features are not asked for
        try:
            source = judge(info.name(), info.source_id(), read_header(xml))
        except (FeatureError, SpecError) as error:
            self._refuse(Refusal.NO_FEATURES, about=info.name(), why=error)
            return
        if source is None:
            return  # nothing is dropped: no feature is of its type
        stage = self._stages.get(_key(info))
        if stage is not None and stage.source.header == source.header:
            stage.follow(info)
            return  # nothing is dropped: it goes on
        if stage is not None:
            self._give_up(_key(info))
        self._waiting.append(_Seen(source, info, self._clock()))

    def _begin(self) -> None:
        """Start the streams of devices that had no new stream for a while."""
        now = self._clock()
        young = {each.source.identity for each in self._waiting if now - each.since_s < SETTLED_S}
        ready = [each for each in self._waiting if each.source.identity not in young]
        self._waiting = [each for each in self._waiting if each.source.identity in young]
        chosen = choose((each.source for each in ready), self._taken)
        by_header = {id(each.header): each for each in chosen}
        for seen in ready:
            source = by_header.get(id(seen.source.header))
            features = source.features if source else ()
            if left := [each for each in seen.source.features if each not in features]:
                self._spare_for_later(replace(seen.source, features=tuple(left)), seen.info)
            if source is not None:
                self._start(source, seen.info)
        for seen in ready:
            if (spare := self._spare.get(seen.info.uid())) is not None:
                self._tell_spare(spare.source)
        for stage in self._stages.values():
            stage.has_rival = self._has_rival(stage.source)

    def _start(self, source: Source, info: pylsl.StreamInfo) -> None:
        """Start to compute further features of a stream."""
        if (earlier := self._stages.pop(_key(info), None)) is not None:
            earlier.close()
            source = replace(source, features=(*earlier.source.features, *source.features))
        seen = _Seen(source, info, self._clock())
        self._stages[_key(info)] = _Stage(seen, self._asking, self._witnesses)


def _key(info: pylsl.StreamInfo) -> str:
    """Return a key of a stream that survives restarts, if it has a source_id.

    Some programs give all streams of a device one source_id.
    """
    return f"{info.type()} {info.source_id()}" if info.source_id() else info.uid()


def _description(info: pylsl.StreamInfo) -> str:
    """Return the full description of a stream from its sender; raises as liblsl does."""
    return fetch_description(info, _DESCRIPTION_S)
