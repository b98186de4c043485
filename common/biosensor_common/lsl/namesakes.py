"""Numbers live senders with the same stream identity, so that each gets its own topic.

People copy a source_id from an example into several scripts. The first sender has the stream's
own name, the second ``<name>_2`` and so on. A number is bound to the sender's computer, format and
shape, if these differ, so that the sender gets it again after a restart of it or the node.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.stream_header import StreamHeader

if TYPE_CHECKING:
    import pylsl


def numbered(header: StreamHeader, number: int) -> StreamHeader:
    """Return the header of a stream with its number appended to the name."""
    if number == 1:
        return header
    name = f"{header.data_name}_{number}"
    return replace(header, data_name=name, chunk=name if header.chunk else "")


class _Place(NamedTuple):
    """Properties of a sender that stay the same over a restart."""

    host: str
    format: int
    channels: int
    rate: float


@dataclass(slots=True)
class _Number:
    place: _Place
    uid: str


class Namesakes:
    """The numbers of all senders, by stream identity."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str, str], list[_Number]] = {}

    def number(self, info: pylsl.StreamInfo, live: Collection[str]) -> int:
        """Return a sender's number, from 1.

        Parameters
        ----------
        info
            Result of a resolver.
        live
            Uids of the senders that are served or shown now; their numbers are in use.
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
    """Return a key that sorts senders by their start time, not by when they were found."""
    return info.created_at(), info.uid()


def _place_of(info: pylsl.StreamInfo) -> _Place:
    return _Place(
        info.hostname(), info.channel_format(), info.channel_count(), info.nominal_srate()
    )
