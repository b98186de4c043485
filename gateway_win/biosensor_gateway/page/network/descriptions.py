"""Reads the headers of streams in a few threads, for each may take as long as its sender likes."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field

import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.lsl.inlets import read_description, unopened_inlet
from biosensor_common.lsl.namesakes import numbered
from biosensor_common.lsl_header import read_header
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from biosensor_gateway.page.network.stream import NetworkStream

TIMEOUT_S = 5.0
_RETRY_S = 10.0
_MOST_TRIES = 3


@dataclass(slots=True)
class _Reading:
    task: Future[tuple[StreamHeader, str]] | None = None
    not_before_s: float = 0.0
    tries: int = field(default=0)


class Descriptions:
    """Reads the header of each outlet once; it needs a connection for a moment, and no data.

    Parameters
    ----------
    pool
        Whose threads read.
    """

    def __init__(self, pool: Executor) -> None:
        self._pool = pool
        self._readings: dict[str, _Reading] = {}

    def update(self, streams: Iterable[NetworkStream], now: float) -> None:
        """Begin to read what is new, and hand over what was read."""
        unread = {each.uid: each for each in streams if not each.has_description}
        for uid, stream in unread.items():
            reading = self._readings.setdefault(uid, _Reading())
            if reading.task is not None and reading.task.done():
                self._settle(stream, reading, now)
            elif reading.task is None and now >= reading.not_before_s:
                reading.tries += 1
                reading.task = self._pool.submit(_read, stream.info, stream.core)
        for uid in self._readings.keys() - unread.keys():
            del self._readings[uid]

    def _settle(self, stream: NetworkStream, reading: _Reading, now: float) -> None:
        assert reading.task is not None
        try:
            header, note = reading.task.result()
            stream.header = numbered(header, stream.namesake)
            stream.note = note or stream.note
            stream.has_description = True
        except RuntimeError:
            # The outlet may have ended, or its computer does not answer.
            reading.task, reading.not_before_s = None, now + _RETRY_S
            stream.header = stream.header or numbered(foreign_header(stream.core), stream.namesake)
            if reading.tries >= _MOST_TRIES:
                stream.has_description = True
                stream.note = "its description could not be read: its computer does not answer"


def _read(info: pylsl.StreamInfo, core: CoreFields) -> tuple[StreamHeader, str]:
    """Return the header, and what is wrong with it.

    Raises
    ------
    RuntimeError
        It does not come in time, or the stream is lost.
    """
    xml = read_description(unopened_inlet(info), info.uid(), TIMEOUT_S).as_xml()
    try:
        return read_header(xml), ""
    except SpecError as error:
        return foreign_header(core), f"its description is not usable: {error}"
