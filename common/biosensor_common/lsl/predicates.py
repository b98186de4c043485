"""Builds the predicates by which liblsl's resolvers find streams.

liblsl puts ``session_id='..' and`` before a predicate and no brackets around it, so that all
but the first term of ``A or B`` find streams of every session. Each predicate that is built here
is in brackets, and values are quoted safely.
"""

from __future__ import annotations

from typing import Literal, NewType

from biosensor_common.errors import SpecError, SpecReason

Predicate = NewType("Predicate", str)
"""XPath 1.0 over the fields of a stream, in brackets; only this module makes them."""

Field = Literal["name", "type", "source_id"]

EVERYTHING = Predicate("(true())")
NOTHING = Predicate("(false())")
IN_ANY_SESSION = Predicate("false() or true()")
"""Finds all streams of all sessions, because it has no brackets."""

_CLOSES = {")": "(", "]": "["}


def equals(field: Field, value: str) -> Predicate:
    """Match streams whose field has this value."""
    # liblsl would stop reading at a NUL, and no header holds one.
    return NOTHING if "\0" in value else Predicate(f"({field}={_quoted(value)})")


def begins_with(field: Field, beginning: str) -> Predicate:
    """Match streams whose field begins with a text."""
    return (
        NOTHING if "\0" in beginning else Predicate(f"(starts-with({field},{_quoted(beginning)}))")
    )


def ends_with(field: Field, ending: str) -> Predicate:
    """Match streams whose field ends with a text; XPath 1.0 has no function for it."""
    if "\0" in ending:
        return NOTHING
    # liblsl's XPath counts the bytes of UTF-8.
    begin = f"string-length({field}) - {len(ending.encode()) - 1}"
    return Predicate(f"(substring({field}, {begin})={_quoted(ending)})")


def has(path: str) -> Predicate:
    """Match streams whose description has this element, such as ``desc/ros``."""
    return Predicate(f"({path})")


def any_of(*predicates: Predicate) -> Predicate:
    """Match streams that match at least one of the predicates."""
    return Predicate(f"({' or '.join(predicates)})") if predicates else NOTHING


def all_of(*predicates: Predicate) -> Predicate:
    """Match streams that match all predicates."""
    return Predicate(f"({' and '.join(predicates)})") if predicates else EVERYTHING


def none_of(*predicates: Predicate) -> Predicate:
    """Match streams that match none of the predicates."""
    return Predicate(f"(not{any_of(*predicates)})")


def of_user(text: str) -> Predicate:
    """Make a predicate from a user's text; only liblsl can check whether it is valid XPath.

    Raises
    ------
    SpecError
        ``INVALID``, if its brackets or quotes are not balanced.
    """
    if not _is_closed(text):
        message = f"the LSL query {text!r} has an unmatched bracket or quote; add the missing one"
        raise SpecError(SpecReason.INVALID, message)
    return Predicate(f"({text})")


def _is_closed(text: str) -> bool:
    quote, opened = "", list[str]()
    for character in text:
        if character == "\0":
            return False
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        elif character in "([":
            opened.append(character)
        elif character in _CLOSES and (not opened or opened.pop() != _CLOSES[character]):
            return False
    return not quote and not opened


def _quoted(text: str) -> str:
    """Quote a text for XPath, which has no escape characters."""
    for quote in ("'", '"'):
        if quote not in text:
            return f"{quote}{text}{quote}"
    parts = ", '\"', ".join(f'"{part}"' for part in text.split('"'))
    return f"concat({parts})"
