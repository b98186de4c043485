"""Says whose folder a stream belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.file_names import labels
from biosensor_gateway.recording.export.markers import is_markers

UNKNOWN = "unknown"
"""Label of who was recorded, where nothing tells it."""
SHARED = "shared"
"""Label of the folder for what belongs to none of several people."""


@dataclass(frozen=True, slots=True)
class Subjects:
    """Who was recorded.

    Attributes
    ----------
    participants
        By label, what the recording calls them; empty of `UNKNOWN` and `SHARED`.
    nobodys
        Label of the folder for streams that name nobody.
    """

    participants: Mapping[str, str]
    nobodys: str

    def of(self, stream: Stream) -> str:
        """Return the label of whose stream it is."""
        name = participant(stream)
        if not name:
            return self.nobodys
        return next(key for key, called in self.participants.items() if called == name)

    def of_markers(self, stream: Stream) -> tuple[str, ...]:
        """Return the labels of those for whom a stream of markers holds: of nobody's, for all."""
        return (self.of(stream),) if participant(stream) else tuple(self.participants)


def participant(stream: Stream) -> str:
    """Return what the recording calls the person who wears the device, empty if it is silent."""
    identity = stream.header.identity
    return "" if identity is None else identity.participant


def find_subjects(chosen: Chosen, streams: Sequence[Stream], named: str) -> Subjects:
    """Find out who was recorded.

    Of a single person are also the streams that name nobody. Where there were several, these
    have a folder of their own, if there are any that are more than markers.

    Parameters
    ----------
    chosen
        Who is left out of it was there, nevertheless.
    streams
        Of these, what is to be written.
    named
        Label of the subject in the recording's name, empty if there is none.
    """
    people = _people(streams)
    if not people and len(_people(chosen.contents.streams)) < 2:
        only = named or UNKNOWN
        return Subjects({only: ""}, only)
    # Reserved, so that nobody's label is the same.
    found = labels({"": [SHARED], **{each: [each] for each in people}})
    shared = found.pop("")
    called = {found[each]: each for each in people}
    if len(_people(chosen.contents.streams)) == 1:
        return Subjects(called, next(iter(called)))
    has_shared = any(not participant(each) and not is_markers(each) for each in streams)
    return Subjects(called | ({shared: ""} if has_shared or not people else {}), shared)


def _people(streams: Sequence[Stream]) -> list[str]:
    named = [participant(each) for each in streams]
    return list(dict.fromkeys(each for each in named if each))
