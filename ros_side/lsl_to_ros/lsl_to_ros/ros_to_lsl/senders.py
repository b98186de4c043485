"""Sends the content of messages: numbers as samples, text as markers."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Sequence
from operator import attrgetter
from time import monotonic
from typing import Any, Protocol, cast

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.fields import NAMES, Field, FieldKind, all_fields
from biosensor_common.ros.layout import Layout, LayoutChangedError, is_part
from lsl_to_ros.ros_to_lsl.class_fields import FRAMES, bulk_of, fields_of
from lsl_to_ros.ros_to_lsl.parameters import SendAs, TopicRequest
from lsl_to_ros.ros_to_lsl.topic_outlets import MarkerOutlet, Origin, SampleOutlet
from lsl_to_ros.subscriber_thread import RosMessage

LINGER_S = 0.25
"""How long an outlet stays open after its last sample, which LSL sends in a separate thread."""
MAX_REPLACED, REPLACED_WITHIN_S = 10, 60.0
_BULK = (
    "its messages carry bulk data in {!r} (images, point clouds and the like), which is not for "
    "LSL; record it with ros2 bag, or name other fields"
)
TEXT_SUFFIX = "__text"
"""Suffix with two underscores, which no topic has, so that the name is unique."""
ToText = Callable[[Any], str]


class Sender(Protocol):
    """One stream of a topic."""

    @property
    def name(self) -> str:
        """Name of the stream."""
        ...

    @property
    def outlet(self) -> SampleOutlet | MarkerOutlet | None:
        """The present outlet; None before there is one."""
        ...

    def send(self, message: RosMessage, stamp: float, origin: Callable[[], Origin]) -> None:
        """Send a message's data for this stream, with an LSL time.

        Raises
        ------
        SpecError
            If the message cannot be sent as requested.
        """
        ...

    def look(self, now: float) -> None:
        """Do scheduled work; call it a few times a second with the LSL time."""
        ...


class NumberSender:
    """Sends the numbers of a message as a sample.

    The outlet is opened by the first message with numbers. A message whose sequences have another
    length or other names opens a new outlet, because LSL cannot change a stream's channels.
    """

    def __init__(self, fields: Sequence[Field], request: TopicRequest, refusals: Refusals) -> None:
        self.name = request.name
        self.outlet: SampleOutlet | None = None
        self.replaced = 0  # How often the outlet was replaced.
        # Label of a channel with an integer that a float cannot represent; empty without any.
        self.inexact = ""
        self._fields, self._request, self._refusals = fields, request, refusals
        self._layout: Layout | None = None
        self._newest: Sequence[float] | None = None
        self._had_consumers = False
        self._left: list[tuple[float, SampleOutlet]] = []
        # nothing is dropped: these are times
        self._replaced_at: deque[float] = deque(maxlen=MAX_REPLACED)

    def send(self, message: RosMessage, stamp: float, origin: Callable[[], Origin]) -> None:
        """See :class:`Sender`."""
        try:
            values = self._layout.read(message) if self._layout else None
        except LayoutChangedError:
            # nothing is dropped: it is read by a new layout
            values = None
        if values is None:
            self._open(message, origin)
            if self._layout is None:
                # nothing is dropped: it has no number, which `_open` reports
                return
            values = self._layout.read(message)
        assert self._layout is not None
        assert self.outlet is not None
        inexact = self._layout.inexact(values)
        if inexact and not self.inexact:
            self.inexact = inexact
            self._refusals.refuse(Refusal.ROUNDED, label=inexact)
        self._newest = values
        self.outlet.push(values, stamp)

    def look(self, now: float) -> None:
        """Close outlets that have been replaced."""
        del now
        self._left = [each for each in self._left if monotonic() - each[0] < LINGER_S]

    def has_new_receiver(self) -> bool:
        """Whether the stream has receivers now, and had none at the last call."""
        had, self._had_consumers = self._had_consumers, self._has_consumers()
        return self._had_consumers and not had

    def repeat(self, stamp: float) -> None:
        """Push the newest sample again, because the value of a latched topic is still valid."""
        if self.outlet is not None and self._newest is not None:
            self.outlet.push(self._newest, stamp)

    def _has_consumers(self) -> bool:
        return self.outlet is not None and self.outlet.have_consumers()

    def _open(self, message: RosMessage, origin: Callable[[], Origin]) -> None:
        before = self.outlet
        layout = Layout(self._fields, message, self._request.fields)
        if not layout.channels:
            # All sequences are empty: wait for a message that defines the number of channels.
            self._refusals.refuse(Refusal.NO_NUMBER)
            return
        self._refusals.over(Refusal.NO_NUMBER)
        if before is not None:
            self._note_replaced()
            self._left.append((monotonic(), before))
            channels = len(layout.channels)
            self._refusals.refuse(Refusal.NEW_CHANNELS, channels=channels, name=self.name)
        self._layout = layout
        self.outlet = SampleOutlet(self.name, origin(), layout.channels, self._request.rate)
        self.outlet.pushed = before.pushed if before else 0

    def _note_replaced(self) -> None:
        self.replaced += 1
        now = monotonic()
        is_full = len(self._replaced_at) == MAX_REPLACED
        if is_full and now - self._replaced_at[0] < REPLACED_WITHIN_S:
            message = (
                "the lengths of its sequences keep changing, but a stream keeps its number of "
                "channels; name fields that stay, or send it as json"
            )
            raise SpecError(SpecReason.CONTRADICTORY, message)
        self._replaced_at.append(now)


class TextSender:
    """Sends the text fields of a numeric message as a marker at first and at each change."""

    def __init__(self, fields: Sequence[Field], name: str) -> None:
        self.name = name
        self.outlet: MarkerOutlet | None = None
        self._read = text_of(fields)
        self._newest: str | None = None

    def send(self, message: RosMessage, stamp: float, origin: Callable[[], Origin]) -> None:
        """See :class:`Sender`."""
        if self.outlet is None:
            self.outlet = MarkerOutlet(self.name, origin())
            self.outlet.is_state = True
        text = self._read(message)
        if text != self._newest:
            self._newest = text
            self.outlet.push(text, stamp)

    def look(self, now: float) -> None:
        """See :class:`Sender`."""
        if self.outlet is not None:
            self.outlet.look(now)


class MarkerSender:
    """Sends each message as a marker.

    Parameters
    ----------
    outlet
        Open already, because a recorder must see it before the first event.
    """

    def __init__(self, read: ToText, name: str, outlet: MarkerOutlet) -> None:
        self.name = name
        self.outlet = outlet
        self._read = read

    def send(self, message: RosMessage, stamp: float, origin: Callable[[], Origin]) -> None:
        """See :class:`Sender`."""
        del origin
        self.outlet.push(self._read(message), stamp)

    def look(self, now: float) -> None:
        """See :class:`Sender`."""
        self.outlet.look(now)


def senders_for(
    message_class: type[Any],
    request: TopicRequest,
    markers: Callable[[], MarkerOutlet],
    refusals: Refusals,
) -> list[Sender]:
    """Return the senders of a message type.

    Parameters
    ----------
    markers
        Returns the marker outlet with the topic's own name.

    Raises
    ------
    SpecError
        ``INVALID`` if a requested field does not exist, ``TOO_LARGE`` for bulk data.
    """
    fields = fields_of(message_class)
    bulk = bulk_of(message_class)
    touched = any(is_part(each, bulk) or is_part(bulk, each) for each in request.fields)
    if bulk and (touched or not request.fields):
        raise SpecError(SpecReason.TOO_LARGE, _BULK.format(bulk))
    # Without a request for them, its numbers would be read from each message for nothing.
    fields = tuple(each for each in fields if each.path != bulk)
    send_as = request.send_as
    if send_as is SendAs.AUTO:
        numbers = any(each.kind is not FieldKind.TEXT for each in _leaves(fields))
        is_report = has_records(fields) and not request.fields
        send_as = SendAs.SAMPLES if numbers and not is_report else SendAs.MARKERS
        with_text = send_as is SendAs.SAMPLES and not request.fields
        if with_text and any(is_text(each) for each in fields):
            text = TextSender(fields, request.name + TEXT_SUFFIX)
            return [NumberSender(fields, request, refusals), text]
    if send_as is SendAs.SAMPLES:
        if not any(each.kind is not FieldKind.TEXT for each in _leaves(fields)):
            message = "its messages have no numbers; leave out 'as', or set it to markers"
            raise SpecError(SpecReason.INVALID, message)
        return [NumberSender(fields, request, refusals)]
    if send_as is SendAs.JSON:
        read: ToText = as_json
    else:
        read = marker_of(message_class, request.topic, request.fields)
    return [MarkerSender(read, request.name, markers())]


def _leaves(fields: tuple[Field, ...]) -> list[Field]:
    return [each for each in all_fields(fields) if each.kind is not FieldKind.MESSAGE]


def is_text(field: Field) -> bool:
    """Whether a field is text for a marker, or a number whose values have names."""
    if field.kind is FieldKind.TEXT:
        return field.name not in (*FRAMES, *(NAMES if field.is_array else ()))
    return bool(field.values)


def has_records(fields: Sequence[Field]) -> bool:
    """Whether there is a list of messages with text fields, as in a report."""
    return any(is_text(inside) for each in fields for inside in each.elements)


def text_of(fields: Sequence[Field], wanted: Sequence[str] = ()) -> ToText:
    """Return a function that makes a marker of a message's text fields.

    One field becomes a marker unchanged; several become a JSON object by their paths.

    Parameters
    ----------
    wanted
        Requested fields; all text fields if empty.

    Raises
    ------
    SpecError
        ``INVALID`` if a requested field does not exist, or none is left.
    """
    chosen = _chosen(fields, wanted)
    if len(chosen) == 1 and not chosen[0].is_array:
        read = _reader(chosen[0])
        return lambda message: _plain(read(message))
    readers = {each.path: _reader(each) for each in chosen}
    return lambda message: _json({path: read(message) for path, read in readers.items()})


def marker_of(message_class: type[Any], topic: str, wanted: Sequence[str] = ()) -> ToText:
    """Return a function that makes a marker of a message: its only field, or all as JSON.

    A message without fields, ``std_msgs/msg/Empty``, becomes a marker with the topic's name.

    Raises
    ------
    SpecError
        ``INVALID`` if a requested field does not exist.
    """
    fields = fields_of(message_class)
    if not fields:
        return lambda _message: topic
    if wanted or len(fields) == 1:
        return text_of(fields, wanted or [fields[0].path])
    return as_json


def as_json(message: RosMessage) -> str:
    """Return a whole message as a JSON object.

    JSON cannot represent NaN and the infinities; they become text, as in protobuf's JSON.
    """
    return _json(_plain_value(message))


def _chosen(fields: Sequence[Field], wanted: Sequence[str]) -> list[Field]:
    chosen = [
        each
        for each in fields
        if (any(each.path == name or each.path.startswith(f"{name}.") for name in wanted))
        or (not wanted and is_text(each))
    ]
    missing = [
        name
        for name in wanted
        if not any(each.path == name or each.path.startswith(f"{name}.") for each in fields)
    ]
    if missing or not chosen:
        known = ", ".join(each.path for each in fields)
        what = repr(missing[0]) if missing else "with text"
        raise SpecError(SpecReason.INVALID, f"there is no field {what}; there are {known[:300]}")
    return chosen


def _reader(field: Field) -> Callable[[Any], object]:
    get, names = attrgetter(field.path), field.values
    if names and not field.is_array:
        return lambda message: names.get(get(message), str(get(message)))
    return lambda message: _plain_value(get(message))


def _word(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"


def _plain(value: object) -> str:
    return value if isinstance(value, str) else _json(value)


def _json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _plain_value(value: Any) -> object:  # noqa: ANN401 - whatever a message has
    if isinstance(value, bytes):
        # rclpy represents a byte of a message as bytes, also in arrays.
        return value[0]
    if isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else _word(value)
    if hasattr(value, "get_fields_and_field_types"):
        names: Sequence[str] = value.get_fields_and_field_types()
        return {name: _plain_value(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Sequence):
        return [_plain_value(each) for each in cast("Sequence[object]", value)]
    return _plain_value(value.item())
