"""Reads raw streams from LSL and sends their features as streams."""

from __future__ import annotations

import socket
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import pylsl

from biosensor_common.errors import SpecError, TransportError
from biosensor_common.errors import SpecError
from biosensor_common.lsl.predicates import any_of, equals
from biosensor_common.lsl_header import read_header
from biosensor_common.lsl_outlet import LslOutlet
from biosensor_gateway.features.choosing import Taken, choose
from biosensor_gateway.features.errors import FeatureError
from biosensor_gateway.features.headers import is_feature, stream_info
from biosensor_gateway.features.outputs import TYPES
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import Source, judge

READ_S = 0.02
LOOK_EVERY = 25
"""Readings from one look at the network to the next."""
SETTLED_S = 3.0
"""Streams of one device appear together; what comes later gets what is left to compute."""
_DESCRIPTION_S = 3.0
_CLOCK_S, _CLOCK_EVERY_S = 1.0, 5.0
_ASKING = 4
"""Threads that wait for other computers, so that reading does not."""
_MOST_HELD = 4096
"""Runs of events that wait for the first correction of their stamps."""
_BUFFER_S = 360
_MOST_SAMPLES = 8192


class Told(Protocol):
    """Is told what happens; each is a sentence or the name of a stream."""

    def found(self, source: Source) -> None:
        """Features of a stream are computed from now on."""
        ...

    def refused(self, sentence: str) -> None:
        """Nothing is computed of a stream."""
        ...


class Sender:
    """The outlets of one source."""

    def __init__(self, source: Source) -> None:
        self._outlets = {
            each.name: LslOutlet(stream_info(source, each)) for each in source.features
        }

    def send(self, events: Sequence[Event], correction_s: float) -> None:
        """Push events, with their stamps on the clock of this computer."""
        for name, outlet in self._outlets.items():
            own = [each for each in events if each.feature == name]
            if own:
                values = np.array([each.values for each in own], np.float32)
                outlet.push_chunk(values, [each.stamp + correction_s for each in own])


class _Correction:
    """What brings the stamps of one stream to the clock of this computer; asked in a thread."""

    def __init__(self, inlet: pylsl.StreamInlet, asking: ThreadPoolExecutor) -> None:
        self._inlet, self._asking = inlet, asking
        self._asked: Future[float] | None = None
        self._next_s = 0.0
        self._last_s: float | None = None

    def seconds(self, now_s: float) -> float | None:
        """Return the last one that is known, None before the first; never waits."""
        if self._asked is None and now_s >= self._next_s:
            self._asked = self._asking.submit(self._inlet.time_correction, _CLOCK_S)
            self._next_s = now_s + _CLOCK_EVERY_S
        if self._asked is not None and self._asked.done():
            # Where there is no answer the last one holds meanwhile: clocks drift slowly.
            if self._asked.exception() is None:
                self._last_s = self._asked.result()
            self._asked = None
        return self._last_s


class _Stage:
    """One source: its inlet, what computes, and what sends."""

    def __init__(self, source: Source, info: pylsl.StreamInfo, asking: ThreadPoolExecutor) -> None:
        self._inlet = pylsl.StreamInlet(info, max_buflen=_BUFFER_S, recover=bool(source.source_id))
        # On one computer stamps stay as they are, to the last bit.
        is_here = info.hostname() == socket.gethostname()
        self._correction = None if is_here else _Correction(self._inlet, asking)
        self._computer = source.new_computer()
        self._sender = Sender(source)
        self._held: deque[Sequence[Event]] = deque(maxlen=_MOST_HELD)

    def read(self, now_s: float) -> None:
        """Take in what has come, and send what can be told by now."""
        pulled: tuple[Any, Any] = self._inlet.pull_chunk(0.0, _MOST_SAMPLES)
        samples, stamps = pulled
        if stamps:
            events = self._computer.take(
                np.array(stamps, np.float64), np.array(samples, np.float64)
            )
            if events:
                self._held.append(events)
        seconds = 0.0 if self._correction is None else self._correction.seconds(now_s)
        while self._held and seconds is not None:
            self._sender.send(self._held.popleft(), seconds)

    def close(self) -> None:
        """Close the inlet."""
        self._inlet.close_stream()


class _Seen:
    def __init__(self, source: Source, info: pylsl.StreamInfo, since_s: float) -> None:
        self.source, self.info, self.since_s = source, info, since_s


class Live:
    """Computes features of all streams on the network, until stopped.

    One thread reads, computes and sends. What has to wait for another computer, a description or
    a clock, is asked in others: a sender that hangs holds up no stream but its own.

    Parameters
    ----------
    told
        Is told what is found.
    clock
        LSL's.
    """

    def __init__(self, told: Told, clock: Callable[[], float] = pylsl.local_clock) -> None:
        self._told, self._clock = told, clock
        self._known: set[str] = set()
        self._waiting: list[_Seen] = []
        self._taken: Taken = set()
        self._stages: list[_Stage] = []
        self._asking = ThreadPoolExecutor(_ASKING, thread_name_prefix="asking")
        self._described: list[tuple[pylsl.StreamInfo, Future[str]]] = []

    def run(self, stopping: threading.Event) -> None:
        """Read and send until it is set."""
        raw_streams = any_of(*(equals("type", each.value) for each in TYPES))
        resolver = pylsl.ContinuousResolver(pred=raw_streams)
        count = 0
        try:
            while not stopping.wait(READ_S):
                if count % LOOK_EVERY == 0:
                    self.look(resolver.results())
                count += 1
                now_s = self._clock()
                for stage in self._stages:
                    stage.read(now_s)
        finally:
            self._asking.shutdown(wait=False, cancel_futures=True)
            for stage in self._stages:
                stage.close()

    def look(self, infos: Sequence[pylsl.StreamInfo]) -> None:
        """Take note of what is on the network, and begin with what is described by now."""
        for info in infos:
            key = info.source_id() or info.uid()
            if key not in self._known:
                self._known.add(key)
                self._described.append((info, self._asking.submit(_description, info)))
        told = [each for each in self._described if each[1].done()]
        self._described = [each for each in self._described if not each[1].done()]
        for info, description in told:
            self._judge(info, description)
        self._begin()

    def _judge(self, info: pylsl.StreamInfo, description: Future[str]) -> None:
        try:
            xml = description.result()
        except (TimeoutError, RuntimeError):
            # It may have ended; if not, the next look finds it again.
            self._known.discard(info.source_id() or info.uid())
            return
        if is_feature(xml):
            return
        try:
            source = judge(info.name(), info.source_id(), read_header(xml))
        except (FeatureError, SpecError) as error:
            self._told.refused(str(error))
            return
        if source is not None:
            self._waiting.append(_Seen(source, info, self._clock()))

    def _begin(self) -> None:
        """Begin with devices of which no new stream has appeared for a while."""
        now = self._clock()
        young = {each.source.identity for each in self._waiting if now - each.since_s < SETTLED_S}
        ready = [each for each in self._waiting if each.source.identity not in young]
        self._waiting = [each for each in self._waiting if each.source.identity in young]
        infos = {id(each.source.header): each.info for each in ready}
        for source in choose((each.source for each in ready), self._taken):
            try:
                stage = _Stage(source, infos[id(source.header)], self._asking)
            except TransportError as error:
                # No more files may be opened.
                self._told.refused(str(error))
                continue
            self._stages.append(stage)
            self._told.found(source)


def _description(info: pylsl.StreamInfo) -> str:
    """Return what the sender of a stream says of it; raises what liblsl does."""
    return pylsl.StreamInlet(info, recover=False).info(_DESCRIPTION_S).as_xml()
