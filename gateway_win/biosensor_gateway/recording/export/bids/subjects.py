"""Says whose folder a stream belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from biosensor_common.quantities import ChannelFormat, ContentType
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.file_names import labels

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


def find_subjects(streams: Sequence[Stream], named: str) -> Subjects:
    """Find out who was recorded.

    Of a single person are also the streams that name nobody. Of several, these have a folder of
    their own, if there are any that are more than markers.

    Parameters
    ----------
    streams
        Which may be fewer than the recording has.
    named
        Label of the subject in the recording's name, empty if there is none.
    """
    named_people = [participant(each) for each in streams]
    people = list(dict.fromkeys(each for each in named_people if each))
    if not people:
        only = named or UNKNOWN
        return Subjects({only: ""}, only)
    # Reserved, so that nobody's label is the same.
    found = labels({"": [SHARED], **{each: [each] for each in people}})
    shared = found.pop("")
    called = {found[each]: each for each in people}
    if len(people) == 1:
        return Subjects(called, next(iter(called)))
    has_shared = any(not participant(each) and not is_markers(each) for each in streams)
    return Subjects(called | ({shared: ""} if has_shared else {}), shared)


def is_markers(stream: Stream) -> bool:
    """Whether a stream tells what happened rather than what was measured."""
    header = stream.header
    is_text = header.format is ChannelFormat.STRING
    kind = header.content_type.lower()
    return is_text or (not header.is_regular and kind == ContentType.MARKERS.lower())
