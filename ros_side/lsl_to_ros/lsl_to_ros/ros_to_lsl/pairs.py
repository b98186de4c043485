"""Names what a list of transforms is sent as: one stream for each pair of frames."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any, Generic, TypeVar

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.ros.layout import is_part
from lsl_to_ros.ros_to_lsl.fields import FramedList, framed_list, type_name
from lsl_to_ros.ros_to_lsl.requests import SendAs, TopicRequest
from lsl_to_ros.taking import RosMessage

MAX_PAIRS = 200
"""So many pairs of frames of one topic become streams, each with an outlet."""
_NO_NAME = re.compile(r"[^A-Za-z0-9_-]+")
Part = TypeVar("Part")


class Pairs(Generic[Part]):
    """The parts of one topic, by their frames.

    Parameters
    ----------
    request
        Of the topic.
    make
        Makes the part for a request, whose messages are of the class.
    refusals
        Of the topic.

    Attributes
    ----------
    left_out
        Pairs of frames that are not sent, because there are too many.
    """

    def __init__(
        self,
        request: TopicRequest,
        make: Callable[[TopicRequest, type[Any]], Part],
        refusals: Refusals,
    ) -> None:
        self._request, self._make, self._refusals = request, make, refusals
        self._parts: dict[tuple[str, str], Part] = {}
        self._names: set[str] = set()
        self.left_out: set[tuple[str, str]] = set()

    @property
    def parts(self) -> list[Part]:
        """Those that there are."""
        return list(self._parts.values())

    def part_of(self, element: RosMessage, kind: type[Any]) -> Part | None:
        """Return the part to which an element belongs; None if there are too many."""
        pair = (element.header.frame_id, element.child_frame_id)
        if pair not in self._parts and len(self._parts) >= MAX_PAIRS:
            self.left_out.add(pair)
            self._refusals.refuse(Refusal.TOO_MANY_PAIRS, len(self.left_out), most=MAX_PAIRS)
            return None
        if pair not in self._parts:
            request = replace(self._request, name=self._name(pair), type_name=type_name(kind))
            self._parts[pair] = self._make(request, kind)
        return self._parts[pair]

    def _name(self, pair: tuple[str, str]) -> str:
        # Frames may have slashes, and names of streams may not: two pairs may look alike.
        plain = "-".join((self._request.name, *(_NO_NAME.sub("-", each) for each in pair)))
        names = (plain if number == 1 else f"{plain}-{number}" for number in count(1))
        name = next(each for each in names if each not in self._names)
        self._names.add(name)
        return name


def parted(message_class: type[Any], request: TopicRequest) -> FramedList | None:
    """Return the list whose elements become streams, if a topic is to be sent so."""
    found = framed_list(message_class)
    if found is None or request.send_as in (SendAs.MARKERS, SendAs.JSON):
        return None  # nothing is dropped: it is sent as a whole
    return None if any(is_part(each, found.name) for each in request.fields) else found
