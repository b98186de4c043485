"""Makes markers of the text in a message, or of all of it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, cast

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.ros.fields import NAMES, Field, FieldKind
from lsl_to_ros.ros_to_lsl.fields import FRAMES, fields_of
from lsl_to_ros.taking import RosMessage

ToText = Callable[[Any], str]


def is_text(field: Field) -> bool:
    """Whether a field is text for a marker, or a number whose values have names."""
    if field.kind is FieldKind.TEXT:
        return field.name not in (*FRAMES, *(NAMES if field.is_array else ()))
    return bool(field.values)


def has_records(fields: Sequence[Field]) -> bool:
    """Whether there is a list of messages that have text of their own, as in a report."""
    return any(is_text(inside) for each in fields for inside in each.elements)


def text_of(fields: Sequence[Field], wanted: Sequence[str] = ()) -> ToText:
    """Return what makes a marker of a message's text fields.

    One field is a marker as it is; several are a JSON object with their paths.

    Parameters
    ----------
    fields
        Of the message's type.
    wanted
        Which of them; all that are text if there is none.

    Raises
    ------
    SpecError
        ``INVALID`` if one of these is no field, or none is left.
    """
    chosen = _chosen(fields, wanted)
    if len(chosen) == 1 and not chosen[0].is_array:
        read = _reader(chosen[0])
        return lambda message: _plain(read(message))
    readers = {each.path: _reader(each) for each in chosen}
    return lambda message: _json({path: read(message) for path, read in readers.items()})


def marker_of(message_class: type[Any], topic: str, wanted: Sequence[str] = ()) -> ToText:
    """Return what makes one marker of a message: its only field as it is, else all as JSON.

    A message without fields, ``std_msgs/msg/Empty``, says only that it came: its marker is the
    name of the topic.

    Raises
    ------
    SpecError
        ``INVALID`` if something that is wanted is no field.
    """
    fields = fields_of(message_class)
    if not fields:
        return lambda _message: topic
    if wanted or len(fields) == 1:
        return text_of(fields, wanted or [fields[0].path])
    return as_json


def as_json(message: RosMessage) -> str:
    """Return a whole message as a JSON object.

    JSON has no words for NaN and the infinities; they are text, as in the JSON of protobuf.
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
        # Python has a byte of a message as bytes, also in arrays.
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
