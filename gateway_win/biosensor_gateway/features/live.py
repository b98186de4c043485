"""Reads raw streams from LSL and sends their features as streams."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
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
_CLOCK_S = 1.0
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
            each.name: pylsl.StreamOutlet(stream_info(source, each)) for each in source.features
        }

    def send(self, events: Sequence[Event], correction_s: float) -> None:
        """Push events, with their stamps on the clock of this computer."""
        for name, outlet in self._outlets.items():
            own = [each for each in events if each.feature == name]
            if own:
                values = np.array([each.values for each in own], np.float32)
                outlet.push_chunk(values, [each.stamp + correction_s for each in own])


class _Stage:
    """One source: its inlet, what computes, and what sends."""

    def __init__(self, source: Source, info: pylsl.StreamInfo) -> None:
        self._inlet = pylsl.StreamInlet(info, max_buflen=_BUFFER_S, recover=bool(source.source_id))
        # On one computer stamps stay as they are, to the last bit.
        self._is_here = info.hostname() == socket.gethostname()
        self._computer = source.new_computer()
        self._sender = Sender(source)
        self._correction_s = 0.0

    def read(self) -> None:
        """Take in what has come, and send what can be told by now."""
        pulled: tuple[Any, Any] = self._inlet.pull_chunk(0.0, _MOST_SAMPLES)
        samples, stamps = pulled
        if not stamps:
            return
        events = self._computer.take(np.array(stamps, np.float64), np.array(samples, np.float64))
        if events:
            self._sender.send(events, self._correction())

    def _correction(self) -> float:
        if not self._is_here:
            try:
                self._correction_s = self._inlet.time_correction(_CLOCK_S)
            except (TimeoutError, RuntimeError):
                # The last one known holds meanwhile: clocks drift slowly.
                return self._correction_s
        return self._correction_s

    def close(self) -> None:
        """Close the inlet."""
        self._inlet.close_stream()


class _Seen:
    def __init__(self, source: Source, info: pylsl.StreamInfo, since_s: float) -> None:
        self.source, self.info, self.since_s = source, info, since_s


class Live:
    """Computes features of all streams on the network, until stopped; one thread does it all.

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

    def run(self, stopping: threading.Event) -> None:
        """Read and send until it is set."""
        types = " or ".join(f"type='{each.value}'" for each in TYPES)
        resolver = pylsl.ContinuousResolver(pred=types)
        count = 0
        try:
            while not stopping.wait(READ_S):
                if count % LOOK_EVERY == 0:
                    self._look(resolver.results())
                count += 1
                for stage in self._stages:
                    stage.read()
        finally:
            for stage in self._stages:
                stage.close()

    def _look(self, infos: Sequence[pylsl.StreamInfo]) -> None:
        for info in infos:
            key = info.source_id() or info.uid()
            if key not in self._known:
                self._known.add(key)
                self._judge(info)
        self._begin()

    def _judge(self, info: pylsl.StreamInfo) -> None:
        try:
            inlet = pylsl.StreamInlet(info, recover=False)
            xml = inlet.info(_DESCRIPTION_S).as_xml()
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
            self._stages.append(_Stage(source, infos[id(source.header)]))
            self._told.found(source)
