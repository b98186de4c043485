"""Numbers live senders that claim to be one stream, so that each has a topic of its own.

People copy a source_id from an example into several scripts. The first sender has the stream's
own name, the second ``<name>_2`` and so on. The number belongs to the sender's computer, format
and shape, as far as these differ: it gets it back whenever it or the node starts again.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.stream_header import StreamHeader

if TYPE_CHECKING:
    import pylsl


def numbered(header: StreamHeader, number: int) -> StreamHeader:
    """Return the header of one of several streams that claim to be the same."""
    if number == 1:
        return header
    name = f"{header.data_name}_{number}"
    return replace(header, data_name=name, chunk=name if header.chunk else "")


class _Place(NamedTuple):
    """What stays the same of a sender when it starts again."""

    host: str
    format: int
    channels: int
    rate: float


@dataclass(slots=True)
class _Number:
    place: _Place
    uid: str


class Namesakes:
    """The numbers of all senders, by what their streams claim to be."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str, str], list[_Number]] = {}

    def number(self, info: pylsl.StreamInfo, live: Collection[str]) -> int:
        """Return a sender's number, from 1.

        Parameters
        ----------
        info
            As a resolver gave it.
        live
            Uids of the senders that are served or shown now; their numbers are taken.
        """
        uid, place = info.uid(), _place_of(info)
        given = self._numbers.setdefault((info.source_id(), info.name(), info.type()), [])
        free = [each for each in given if each.uid not in live or each.uid == uid]
        of_same_place = [each for each in free if each.place == place]
        chosen = next(iter([*of_same_place, *free]), None)
        if chosen is None:
            chosen = _Number(place, uid)
            given.append(chosen)
        chosen.place, chosen.uid = place, uid
        return given.index(chosen) + 1


def by_start(info: pylsl.StreamInfo) -> tuple[float, str]:
    """Return what sorts senders by their start, whichever was found first."""
    return info.created_at(), info.uid()


def _place_of(info: pylsl.StreamInfo) -> _Place:
    return _Place(
        info.hostname(), info.channel_format(), info.channel_count(), info.nominal_srate()
    )
